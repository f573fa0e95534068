from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.protocol.gcode.commands import numbered, stay_awake, straight


@pytest.mark.parametrize(
    ("number", "command", "line"),
    [  # of the RepRap wiki's page "G-code"
        (3, "T0", b"N3 T0*57\n"),
        (4, "G92 E0", b"N4 G92 E0*67\n"),
        (5, "G28", b"N5 G28*22\n"),
        (6, "G1 F1500.0", b"N6 G1 F1500.0*82\n"),
        (7, "G1 X2.0 Y2.0 F3000.0", b"N7 G1 X2.0 Y2.0 F3000.0*85\n"),
    ],
)
def test_lines_as_the_world_has_them(number: int, command: str, line: bytes) -> None:
    assert numbered(number, command) == line


@given(st.integers(0, 2**31 - 1), st.floats(-2000, 2000), st.integers(0, 30), st.integers(0, 7))
def test_a_turned_bit_shows(number: int, x_mm: float, place: int, bit: int) -> None:
    line = bytearray(numbered(number, straight(x_mm, 0, 0, 10)))
    body, _, checksum = bytes(line[:-1]).rpartition(b"*")
    damaged = bytearray(body)
    damaged[place % len(body)] ^= 1 << bit
    found = 0
    for byte in damaged:
        found ^= byte
    assert found != int(checksum)


@given(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(0.02, 100))
def test_a_move_says_its_place_within_half_a_micrometre_and_is_never_faster(
    x_mm: float, y_mm: float, z_mm: float, feed_mm_s: float
) -> None:
    command = straight(x_mm, y_mm, z_mm, feed_mm_s)
    found = re.fullmatch(r"G1 X(-?\d+\.\d{3}) Y(-?\d+\.\d{3}) Z(-?\d+\.\d{3}) F(\d+)", command)
    assert found is not None
    assert "-0.000" not in command
    for text, value in zip(found.groups()[:3], (x_mm, y_mm, z_mm), strict=True):
        assert abs(float(text) - value) <= 0.000501
    assert int(found[4]) <= 60 * feed_mm_s


@pytest.mark.parametrize(("z_mm", "feed_mm_s"), [(float("nan"), 10), (float("inf"), 10), (1e7, 10), (0, 0.01), (0, -5)])
def test_what_is_no_move_is_not_sent(z_mm: float, feed_mm_s: float) -> None:
    with pytest.raises(ValueError, match="is n"):
        straight(0, 0, z_mm, feed_mm_s)


def test_klipper_is_not_told_to_let_go_of_its_motors() -> None:
    assert stay_awake("Marlin 2.1.2") == "M84 S0"
    assert stay_awake("Klipper v0.12") == "SET_IDLE_TIMEOUT TIMEOUT=86400"
