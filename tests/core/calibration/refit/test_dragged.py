from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated_sensor import HALF, calibrated, simulated

from tacshade_edge.core.calibration.refit.dragged import (
    LONGEST_MM,
    Drag,
    dragged_map,
    dragged_picture,
    moved_part,
    pixels_of,
    px_per_mm,
    random_drags,
)
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import U8, Bool, Disc

DISC = Disc(60.0, 80.0, 50.0)
SHAPE = (120, 160)
DISC_OF_HALF = HALF.geometry.disc
drags = st.builds(Drag, st.floats(-30, 30), st.floats(-30, 30), st.floats(2, 80), st.floats(0, 1))


def touched(row: float, col: float, radius: float) -> Bool:
    rows, cols = np.ogrid[: SHAPE[0], : SHAPE[1]]
    return np.asarray(np.hypot(rows - row, cols - col) < radius)


def test_the_skin_under_the_indenter_moves_with_it_and_less_further_away() -> None:
    drag = Drag(3.0, -6.0, 5.0, 0.2)
    part = moved_part(touched(60, 80, 8), DISC, drag)
    assert part[63, 74] == pytest.approx(1)
    along = part[63, 74:20:-1]
    assert (np.diff(along) <= 1e-6).all()
    assert part[63, 50] == pytest.approx(0.2, abs=0.05)
    assert part[60, 80 - 50] < 0.05
    assert not part[~touched(60, 80, 50)].any()


@given(drags)
def test_no_pixel_of_the_disc_shows_what_lies_outside(drag: Drag) -> None:
    outside = np.where(touched(60, 80, 51), 0, 255).astype(np.uint8)  # a pixel shows its neighbours, too
    part = moved_part(touched(50, 70, 10), DISC, drag)
    assert part.min() >= 0
    assert part.max() <= 1 + 1e-6
    seen = dragged_picture(outside, part, drag)
    assert not seen[touched(60, 80, 49)].any()
    np.testing.assert_array_equal(seen[~touched(60, 80, 52)], 255)


def test_picture_and_map_move_alike() -> None:
    grid, drag = disc_map.map_grid(DISC, 56), Drag(5.0, 4.0, 12.0, 0.1)
    rows, cols = np.indices(SHAPE)
    picture = (100 + rows + cols / 2).astype(np.uint8)
    at = np.rint(grid.row0 + grid.step_px * np.arange(56)).astype(int)
    beside = np.rint(grid.col0 + grid.step_px * np.arange(56)).astype(int)
    part = moved_part(touched(55, 75, 9), DISC, drag)
    moved = dragged_map(picture[np.ix_(at, beside)].astype(np.float32), part, drag, grid, 0)
    seen = dragged_picture(picture, part, drag)[np.ix_(at, beside)]
    inside = touched(60, 80, 46)[np.ix_(at, beside)]
    np.testing.assert_allclose(moved[inside], seen[inside], atol=2)


def test_cells_cover_the_pixels_around_their_middles() -> None:
    grid = disc_map.map_grid(DISC, 28)
    cells = np.zeros((28, 28), bool)
    cells[14, 10] = True
    found = np.argwhere(pixels_of(cells, grid, SHAPE)).mean(axis=0)
    middle = grid.row0 + 14 * grid.step_px, grid.col0 + 10 * grid.step_px
    np.testing.assert_allclose(found, middle, atol=0.5)
    assert not pixels_of(np.ones((28, 28), bool), grid, SHAPE)[:, 0].any()


def test_drags_go_in_all_directions_and_no_further_than_stated() -> None:
    geometry = calibrated().geometry
    drawn = random_drags(geometry, 200, np.random.default_rng(1))
    px = np.array([(drag.row_px, drag.col_px) for drag in drawn])
    far_mm = np.linalg.norm(px, axis=1) * 20 / px_per_mm(geometry) / geometry.skin_radius_mm
    assert 0.95 * LONGEST_MM < far_mm.max() <= LONGEST_MM
    assert (np.sign(px).mean(axis=0) < 0.2).all()


def test_a_drag_out_of_the_image_moves_nothing() -> None:
    assert not moved_part(touched(60, 80, 5), DISC, Drag(500.0, 0.0, 5.0, 0.3)).any()


def test_a_warped_picture_is_like_one_of_a_true_drag() -> None:
    """The simulator drags the skin by friction; the warp knows its λt and its sway, and no friction."""
    drag_mm, sensor, px = 1.2, simulated(HALF), px_per_mm(HALF.geometry)
    still = sensor.frame((Press(ball(5.0), -drag_mm, 0.0, 3.0),), 1)
    dragged = sensor.frame((Press(ball(5.0), 0.0, 0.0, 3.0, drag_x_mm=drag_mm),), 1)
    drag = Drag(0.0, drag_mm * px, HALF.drag_decay_mm * px, HALF.sway)
    warped = dragged_picture(still.image, moved_part(still.truth().contact, HALF.geometry.disc, drag), drag)
    near = disc_mask(HALF.image_height_px, HALF.image_width_px, replace(DISC_OF_HALF, radius_px=50.0))

    def off(image: U8) -> float:
        return float(np.abs(image.astype(float) - dragged.image)[near].mean())

    assert off(warped) < 0.6 * off(still.image)
