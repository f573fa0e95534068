from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.tradeoff.grid import DENOISERS, WORDS, Setting, grid, make
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import TOUCHED, painted_calibration


def test_the_whole_grid_has_every_profile_and_no_setting_twice() -> None:
    settings = grid(list(PROFILES))
    assert len(settings) <= 40
    assert len(settings) == len(set(settings)) == len({str(setting) for setting in settings})
    assert [setting.profile.name for setting in settings if setting.shipped] == list(PROFILES)
    assert all(bool(setting.varied) != setting.shipped for setting in settings)
    for dimension in WORDS:
        assert len({setting.fields[dimension] for setting in settings}) > 1


def test_a_setting_says_what_differs() -> None:
    paper = PROFILES["paper"]
    changed = replace(paper, stride_px=4, tv_weight=0.0)
    setting = Setting(changed, whole_disc=True, scaled_grey=True, tv_iterations=7)
    assert str(setting) == "paper, solver grey, stride 4 px, TV 0, TV 7 times, whole disc"
    assert str(Setting(paper)) == "paper"
    assert not Setting(paper, whole_disc=True).shipped
    assert {setting.varied for setting in grid(["fast", "accurate"])} >= {"halved", "not halved"}


def test_what_differs_is_what_runs() -> None:
    frame, calibration = Frame(0, 0, 0, TOUCHED), painted_calibration()
    paper = PROFILES["paper"]
    settings = (
        Setting(paper),
        Setting(replace(paper, stride_px=4)),
        Setting(paper, scaled_grey=True),
        Setting(paper, tv_iterations=2),
        *(Setting(paper, tv_precision=precision) for precision in DENOISERS if precision != "float32"),
    )
    fine, coarse, grey, *denoised = (make(setting, calibration).step(frame) for setting in settings)
    assert fine.height.height_mm.size > 10 * coarse.height.height_mm.size
    assert grey.height.height_mm.tobytes() != fine.height.height_mm.tobytes()
    heights = {found.height.height_mm.tobytes() for found in (fine, *denoised)}
    assert len(heights) == 1 + len(denoised)


@pytest.mark.parametrize("name", ["fast", "paper"])
def test_over_the_whole_disc_the_same_objects_are_found(name: str) -> None:
    frame, calibration = Frame(0, 0, 0, TOUCHED), painted_calibration()
    box, disc = (make(Setting(PROFILES[name], whole), calibration).step(frame) for whole in (False, True))
    assert box.contact
    assert len(box.cloud.points_mm) > 0
    assert box.cloud.points_mm.tobytes() == disc.cloud.points_mm.tobytes()
    np.testing.assert_array_equal(box.height.contact, disc.height.contact)
