from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.devices.frame_table import HEADER, read_table, table_in
from tacshade_edge.errors import ConfigError


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("", r"frames\.csv: found no row, expected one for each frame"),
        ("a.png,1\n", r"frames\.csv:2: found 2 columns, expected 9"),
        (",1,,,,,,,\n", ":2: image: found nothing, expected a file's name"),
        ("a.png,,,,,,,,\n", ":2: t_ns: found '', expected a whole number from 0 to"),
        ("a.png,-1,,,,,,,\n", ":2: t_ns: found '-1', expected a whole number"),
        ("a.png,1.5,,,,,,,\n", ":2: t_ns: found '1.5', expected a whole number"),
        (f"a.png,{2**62 + 1},,,,,,,\n", ":2: t_ns: found '4611686018427387905', expected a whole number"),
        ("a.png,5,,,,,,,\na.png,5,,,,,,,\n", ":3: t_ns: found 5, expected more than 5 of the row before"),
        ("a.png,5,1,,,,,,\n", ":2: x_mm to qz: found 1 of the 7, expected all or none"),
        ("a.png,5,1,2,x,1,0,0,0\n", ":2: z_mm: found 'x', expected a number"),
        ("a.png,5,1,2,3,1,1,0,0\n", ":2: qw, qx, qy, qz: found the norm 1.414, expected a unit quaternion"),
    ],
)
def test_a_wrong_table_is_told_by_line_and_column(tmp_path: Path, row: str, said: str) -> None:
    (tmp_path / "frames.csv").write_text(",".join(HEADER) + "\n" + row)
    with pytest.raises(ConfigError, match=said) as refusal:
        read_table(tmp_path / "frames.csv")
    assert "\n" not in str(refusal.value)


def test_the_table_of_a_writer_that_died_is_read_to_its_last_whole_line(tmp_path: Path) -> None:
    assert table_in(tmp_path) is None
    partial, table = tmp_path / "frames.csv.part", tmp_path / "frames.csv"
    partial.write_text(",".join(HEADER) + "\na.png,5,,,,,,,\nb.png,61,,,,,,")
    assert table_in(tmp_path) == partial
    assert [row.image for row in read_table(partial, cut_off=True)] == ["a.png"]
    with pytest.raises(ConfigError, match="part:3: found 8 columns, expected 9"):
        read_table(partial)
    table.touch()
    assert table_in(tmp_path) == table
