from __future__ import annotations

import math

import numpy as np
import pytest
from support.calibrated_sensor import HALF, pressed, reconstructor

from tools.studies.drag.work import DEPTHS_MM, DIRECTIONS
from tools.studies.sigma.work import DRAGGED_MM, presses, true_height_mm


def test_objects_are_pressed_and_dragged_as_by_the_study_of_drag() -> None:
    made = list(presses(HALF, 5, "cube"))
    assert len(made) == len(DRAGGED_MM) * DIRECTIONS * len(DEPTHS_MM)
    for drag_mm, press in made:
        assert math.hypot(press.drag_x_mm, press.drag_y_mm) == pytest.approx(drag_mm * HALF.skin_radius_mm / 20)
        assert (press.twist_deg, press.tilt_x_deg) == (0.0, 0.0)


@pytest.mark.slow
def test_the_true_height_is_that_of_the_pixel() -> None:
    frame, grid = pressed("ball", 3.0), reconstructor("fast").grid
    where = np.zeros((grid.rows, grid.cols), bool)
    where[::7, 20:40:7] = True
    found, true = true_height_mm(frame, grid, where), frame.truth().height_mm
    rows, cols = (
        np.rint(first + grid.step_px * each).astype(int)
        for first, each in zip((grid.row0, grid.col0), np.nonzero(where), strict=True)
    )
    inside = np.isfinite(true[rows, cols])
    assert inside.sum() > 8
    np.testing.assert_allclose(found[inside], true[rows, cols][inside], atol=0.15)  # half a pixel of slope
