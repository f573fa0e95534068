from __future__ import annotations

import math

import pytest

from tacshade_edge.studies.evaluate.sensors import SensorName
from tacshade_edge.studies.parallel import ThisProcess
from tools.studies.slip.work import HeldRow, Plan, ReleaseRow, SlideRow, study


@pytest.mark.slow
def test_a_slide_and_a_hold() -> None:
    plan = Plan((SensorName("tacshade", 5),), ("fast",), ("ball",), (20.0,), held_s=0.5, released_s=3.0)
    rows = study(plan, ThisProcess(), lambda what, done, of: None)
    (held,) = [row for row in rows if isinstance(row, HeldRow)]
    assert (held.held_s, held.slips) == (0.5, 0)
    (released,) = [row for row in rows if isinstance(row, ReleaseRow)]
    assert 0 <= released.dent_mm < 0.1 * released.depth_mm + 0.01
    assert released.frames + released.phantoms > 0
    slides = [row for row in rows if isinstance(row, SlideRow)]
    assert len(slides) == 2
    for row in slides:
        assert 0.3 < row.onset_s < 1.0
        assert not math.isnan(row.told_s)
        assert 0 < row.true_mm_s <= 21
