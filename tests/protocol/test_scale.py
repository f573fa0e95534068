from __future__ import annotations

import pytest

from tacshade_edge.capture.scale import parse_reading


@pytest.mark.parametrize(
    ("line", "newtons"),
    [
        (b"1.5 N", 1.5),
        (b"-0,250 kg", -0.25 * 9.80665),
        (b"ST,GS,+  0.123kg\r", 0.123 * 9.80665),
        (b"US,NT,-00012.5  g", -0.0125 * 9.80665),
        (b"+ 100 g", 0.980665),
        (b"G     .5 g", 0.0005 * 9.80665),
        (b"16 oz", 4.4482216152605),
        (b"1 lbf", 4.4482216152605),
        (b"250 mN", 0.25),
        (b"N 12 pcs 30.0 G", 0.03 * 9.80665),
        (b"12.5", None),
        (b"12.5 pcs", None),
        (b"OL kg", None),
        (b"\xff\xfe", None),
        (b"", None),
    ],
)
def test_a_line(line: bytes, newtons: float | None) -> None:
    assert parse_reading(line) == (None if newtons is None else pytest.approx(newtons, rel=1e-9))
