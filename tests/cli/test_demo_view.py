from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.cli.demo_view import MAP_COLS, MAP_ROWS, character_map, status_line
from tacshade_edge.types import HeightMap, ObjectCloud, Reconstruction, TouchedObject


def height_map(height_mm: np.ndarray) -> HeightMap:
    return HeightMap(height_mm.astype(np.float32), np.zeros(height_mm.shape, dtype=bool), 0, 0, 1)


def result(*, valid: bool = True, depths: tuple[float, ...] = ()) -> Reconstruction:
    return Reconstruction(
        seq=0,
        t_ns=0,
        wall_ns=0,
        profile="fast",
        valid=valid,
        reason="" if valid else "black",
        contact=bool(depths),
        saturated=False,
        degraded="",
        height=height_map(np.zeros((2, 2))),
        cloud=ObjectCloud(np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.uint16)),
        objects=tuple(TouchedObject(i + 1, (0, 0, 0), (1, 1, 1), d, 1.0) for i, d in enumerate(depths)),
    )


@pytest.mark.parametrize(
    ("shown", "line"),
    [
        (result(), "no contact  depth  0.00 mm (pressed 2.50)  0 objects  29.9 fps  fast"),
        (result(depths=(2.375,)), "contact     depth  2.38 mm (pressed 2.50)  1 object  29.9 fps  fast"),
        (result(depths=(2.0, 1.0)), "contact     depth  2.00 mm (pressed 2.50)  2 objects  29.9 fps  fast"),
        (result(valid=False), "invalid: black"),
    ],
)
def test_the_status_line(shown: Reconstruction, line: str) -> None:
    assert status_line(shown, 2.5, 29.94) == line


def test_the_map_shows_the_disc_alone_with_rising_characters() -> None:
    rows, cols = np.mgrid[:120, :160]
    radius = np.hypot(rows - 60, cols - 80)
    height = np.where(radius < 50, np.where(radius < 12, 9.0, 0.0), np.nan)
    lines = character_map(height_map(height))
    assert len(lines) == MAP_ROWS
    assert {len(line) for line in lines} == {MAP_COLS}
    middle = lines[MAP_ROWS // 2]
    assert middle[0] == middle[-1] == "."
    assert middle[MAP_COLS // 2] == "@"
    assert lines[0][0] == " "
    ramp = "".join(character_map(height_map(np.tile(np.linspace(0, 4, 160), (120, 1))))[0])
    assert list(dict.fromkeys(ramp)) == list(".:-=+*#%@")


def test_a_map_without_a_disc_is_blank() -> None:
    assert set("".join(character_map(height_map(np.full((4, 4), np.nan))))) == {" "}
