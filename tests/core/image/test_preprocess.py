from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, pressed, unloaded

from tacshade_edge.core.contact.gate import ContactGate
from tacshade_edge.core.image.median import median
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.simulator import camera_faults
from tacshade_edge.types import F32

CHANGE = np.float32(60)


def of_ratio(preprocessor: Preprocessor, g: F32) -> Preprocessed:
    """An image of this white ratio."""
    g_d = np.float32(preprocessor.sign) * (g - preprocessor.reference_g)[preprocessor.voting]
    return Preprocessed(g, g_d, median(g_d), preprocessor.reference_white, 0.0)


@pytest.mark.parametrize("polarity", ["bright", "dark"])
def test_only_cells_with_a_vote_open_the_gate(polarity: str) -> None:
    preprocessor = Preprocessor(replace(calibrated(HALF, 0), polarity=polarity), PROFILES["accurate"])
    gate, reference = ContactGate(preprocessor), preprocessor.reference_g
    change = CHANGE if polarity == "bright" else -CHANGE
    assert (preprocessor.rays.inside & ~preprocessor.voting).sum() > 100  # at the rim
    assert not gate.opens(of_ratio(preprocessor, reference))
    assert not gate.opens(of_ratio(preprocessor, np.where(preprocessor.voting, reference, reference + change)))
    raised = reference.copy()
    raised.flat[np.flatnonzero(preprocessor.voting)[1000:1080]] += change
    assert gate.opens(of_ratio(preprocessor, raised))
    everywhere = of_ratio(preprocessor, reference + change)
    assert not gate.opens(everywhere)
    assert everywhere.drift_grey == pytest.approx(CHANGE, abs=1e-3)


@pytest.mark.parametrize("polarity", ["bright", "dark"])
@pytest.mark.parametrize("profile", ["paper", "balanced"])
def test_the_change_is_eq_9_of_the_ratio(profile: str, polarity: str) -> None:
    preprocessor = Preprocessor(replace(calibrated(HALF, 0), polarity=polarity), PROFILES[profile])
    found = preprocessor.preprocess(preprocessor.grey(pressed("ball", 3.0).image))
    expected = of_ratio(preprocessor, found.g)
    np.testing.assert_array_equal(found.g_d, expected.g_d)
    assert found.drift_grey == expected.drift_grey
    assert found.unseen == 0


@pytest.mark.parametrize("profile", PROFILES)
def test_a_value_is_of_its_image_whatever_came_after_it(profile: str) -> None:
    preprocessor = Preprocessor(calibrated(HALF, 0), PROFILES[profile])
    images = [pressed("ball", 3.0).image, camera_faults.glare(unloaded(), 110, 190, 12), unloaded() * 0]

    def everything(found: Preprocessed) -> tuple[object, ...]:
        arrays = (found.g, found.g_d, found.white.total)
        assert not any(array.flags.writeable for array in arrays)
        return (found.drift_grey, found.unseen, *(array.tobytes() for array in arrays))

    found = [preprocessor.preprocess(preprocessor.grey(image)) for image in images]
    before = [everything(each) for each in found]
    assert len(set(before)) == len(images)
    assert [everything(preprocessor.preprocess(preprocessor.grey(image))) for image in reversed(images)] == before[::-1]
    assert [everything(each) for each in found] == before
