"""Numbers as a person reads them, in every file that we read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import load, strict_yaml
from tacshade_edge.settings.printer_file import read_printer
from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.storage.tables.indenters import read_indenters_file

SENSOR = "skin_radius_mm: {}\nvisible_half_angle_deg: 50\npolarity: bright\n"
PRINTER = "x_mm: [0, 220]\ny_mm: [0, 220]\nz_mm: [{}, 200]\nstart_mm: [110, 110, 90]\nfeed_mm_s: 50\n"
FILES: list[tuple[str, Callable[[Path], object]]] = [
    ("source: {{kind: simulated}}\nserial: {{device: /dev/ttyUSB0, baud: {}}}\n", load),
    ("source: {{kind: v4l2, width: {}}}\n", load),
    (SENSOR, read_sensor),
    ("flange_T_sensor: [{}, 0, 0, 1, 0, 0, 0]\n" + SENSOR.format(20), read_sensor),
    (PRINTER, read_printer),
    ("pin: {{shape: ball, radius_mm: {}}}\n", read_indenters_file),
]


@pytest.mark.parametrize(("text", "read"), FILES)
@pytest.mark.parametrize(
    ("number", "meant"),
    [
        *(("0115200", 39552), ("040", 32), ("000", 0), ("-017", -15), ("020.5", 20.5), ("1_000", 1000)),
        *(("0x28", 40), ("0b101", 5), ("1:30", 90), ("1:30.5", 90.5), ("0_7", 7)),
    ],
)
def test_a_number_that_yaml_reads_in_its_own_way_is_refused(
    tmp_path: Path, text: str, read: Callable[[Path], object], number: str, meant: float
) -> None:
    path = tmp_path / "any.yaml"
    path.write_text(text.format(number))
    expected = f"found {number}, which YAML reads as {meant}, expected a plain decimal number, or quotes around text"
    with pytest.raises(ConfigError) as refused:
        read(path)
    assert expected in str(refused.value)
    assert str(refused.value).startswith(f"{path}:")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("3e1", 30), ("3E+1", 30), ("2.5e1", 25), ("-.5", -0.5), ("1.", 1), ("+7", 7), ("0", 0), ("-0.0", 0)),
        *(("1e-3", 0.001), ("1.0e-05", 1e-5), ("0.5", 0.5)),
        *(("'3e1'", "3e1"), ("'040'", "040"), ("080", "080"), ("1e", "1e"), ("e1", "e1"), ("٣", "٣")),
    ],
)
def test_plain_decimals_are_numbers_and_quoted_ones_are_text(tmp_path: Path, text: str, value: object) -> None:
    path = tmp_path / "any.yaml"
    path.write_text(f"a: {text}\n", encoding="utf-8")
    found, _, mistakes = strict_yaml.read(path)
    assert (found, mistakes) == ({"a": value}, [])
    assert type(found["a"]) in ((str,) if isinstance(value, str) else (int, float))


@given(st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False)))
def test_every_number_that_python_writes_comes_back(tmp_path_factory: pytest.TempPathFactory, number: float) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(f"a: {number!r}\n")
    assert strict_yaml.read(path)[0] == {"a": number}
