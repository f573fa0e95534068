from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.trade_points import point

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.tradeoff import picture
from tacshade_edge.studies.tradeoff.summary import Estimate

NAN = float("nan")


@pytest.mark.slow  # it imports matplotlib
@pytest.mark.parametrize("budget_ms", [None, 3.0])
def test_points_without_intervals_or_figures_are_drawn_or_left_out(budget_ms: float | None) -> None:
    points = [
        point("fast", 0.2, 1.0, front=True),
        replace(point("accurate", 0.1, 3.0, front=True), me_mm=Estimate(0.1, NAN, NAN)),
        replace(point(replace(PROFILES["paper"], stride_px=8), 2.0, 9.0), p50_ms=Estimate(NAN, NAN, NAN)),
    ]
    image = cv2.imdecode(np.frombuffer(picture.draw(points, budget_ms), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.std() > 10
