from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.settings.printer_file import read_printer

GOOD = "x_mm: [0, 220]\ny_mm: [-5, 215]\nz_mm: [40, 200]\nstart_mm: [110, 105, 90.5]\nfeed_mm_s: 50\n"


def test_what_is_stated_of_a_printer(tmp_path: Path) -> None:
    path = tmp_path / "PRINTER.yaml"
    path.write_text(GOOD)
    printer = read_printer(path)
    assert (printer.z_mm, printer.start_mm, printer.feed_mm_s, printer.baud) == (
        [40, 200],
        [110, 105, 90.5],
        50,
        115200,
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[0, 220]", "[220, 0]", ":1: x_mm: found 220 to 0, expected the minimum before the maximum"),
        (
            "[0, 220]",
            "[0]",
            ":1: x_mm: found a list of 1, expected a list of 2 numbers (two numbers, the least and the most)",
        ),
        ("[0, 220]", "[0, far]", ":1: x_mm.1: found far, expected a number from -2000 to 2000"),
        ("90.5", "30", ":4: start_mm: found z 30, expected a value within z_mm (40 to 200)"),
        ("feed_mm_s: 50", "feed_mm_s: 500", ":5: feed_mm_s: found 500, expected a number from 1 to 100"),
        ("feed_mm_s: 50", "", ": feed_mm_s: found nothing, expected a number from 1 to 100"),
        ("feed_mm_s", "feed_mm_min", ":5: feed_mm_min: found an unknown key, expected one of"),
    ],
)
def test_mistakes_are_told_with_their_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "PRINTER.yaml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        read_printer(path)
    assert f"{path}{said}" in str(caught.value)
