from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.studies.tradeoff.grid import Setting
from tacshade_edge.studies.tradeoff.timing import IDLE_FRAMES, time_settings
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration


def quiet(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


def test_every_setting_is_timed_in_every_round() -> None:
    settings = [Setting(PROFILES["fast"]), Setting(replace(PROFILES["fast"], stride_px=8))]
    threads = cv2.getNumThreads()
    times, busy = time_settings(
        settings, painted_calibration(), [[TOUCHED, TOUCHED], [TOUCHED]], [FREE], quiet, rounds=3
    )
    assert busy > 0.9
    assert cv2.getNumThreads() == threads
    for each, most in zip(times, (2, 1), strict=True):
        assert len(each.contact) == len(each.idle) == 3
        for some in each.contact:
            assert some.shape[1] == 1 + len(STAGES)
            assert 1 <= len(some) <= most
            assert (some[:, 0] > 0).all()
            stages = dict(zip(STAGES, some[:, 1:].T, strict=True))
            for unasked in ("shear", "sigma"):
                assert (stages.pop(unasked) > 0).all()  # not in the step's time: few ask for it
            np.testing.assert_allclose(some[:, 0], np.nansum(list(stages.values()), axis=0))
        assert all(len(some) == IDLE_FRAMES and (some > 0).all() for some in each.idle)


def test_a_setting_that_finds_no_contact_and_no_frames_without_are_nothing() -> None:
    (times,), _ = time_settings([Setting(PROFILES["fast"])], painted_calibration(), [[]], [], quiet, rounds=2)
    assert [some.shape for some in times.contact] == [(0, 1 + len(STAGES))] * 2
    assert [len(some) for some in times.idle] == [0, 0]


def test_a_stage_that_is_not_run_is_nan() -> None:
    (times,), _ = time_settings([Setting(PROFILES["fast"])], painted_calibration(), [[FREE]], [], quiet, rounds=1)
    ran = np.isfinite(times.contact[0][0])
    assert dict(zip(STAGES, ran[1:], strict=True))["check"]
    assert not dict(zip(STAGES, ran[1:], strict=True))["depth"]
