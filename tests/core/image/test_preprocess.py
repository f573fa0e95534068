from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated

from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES

CHANGE = np.float32(60)


@pytest.mark.parametrize("polarity", ["bright", "dark"])
def test_only_cells_with_a_vote_open_the_gate(polarity: str) -> None:
    front = Preprocessor(replace(calibrated(HALF, 0), polarity=polarity), PROFILES["accurate"])
    unloaded = front.reference_ratio
    change = CHANGE if polarity == "bright" else -CHANGE
    assert (front.rays.inside & ~front.voting).sum() > 100  # at the rim
    assert not front.gate(unloaded).contact
    assert not front.gate(np.where(front.voting, unloaded, unloaded + change)).contact
    touched = unloaded.copy()
    middle = np.flatnonzero(front.voting)[1000:1080]
    touched.flat[middle] += change
    assert front.gate(touched).contact
    everywhere = front.gate(unloaded + change)
    assert not everywhere.contact
    assert everywhere.drift_grey == pytest.approx(CHANGE, abs=1e-3)
