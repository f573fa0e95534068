"""The time of a step's stages."""

from __future__ import annotations

import cv2
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.studies.evaluate.work import one_thread, stages_ms, work_ns
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration


def test_the_stages_that_are_run_in_their_order() -> None:
    made = make_reconstructor(painted_calibration(), PROFILES["fast"])
    touched, free = (stages_ms(made, Frame(0, 0, 0, image)) for image in (TOUCHED, FREE))
    assert tuple(touched) == tuple(stage for stage in STAGES if stage != "denoise")
    assert tuple(free) == ("check", "grey", "gate")
    assert min(*touched.values(), *free.values()) >= 0
    assert sum(touched.values()) > 0
    assert sum(stages_ms(made, Frame(0, 0, 0, TOUCHED), work_ns).values()) > 0


def test_the_threads_are_as_before_also_after_a_failure() -> None:
    before = cv2.getNumThreads()
    during = []

    def fail() -> None:
        with one_thread():
            during.append(cv2.getNumThreads())
            raise ValueError("x")

    with pytest.raises(ValueError, match="x"):
        fail()
    assert during == [1]
    assert cv2.getNumThreads() == before
