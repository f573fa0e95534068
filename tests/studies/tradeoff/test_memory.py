from dataclasses import replace

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.tradeoff.grid import Setting
from tacshade_edge.studies.tradeoff.memory import peak_memory
from tools.testbed.painted_sensor import TOUCHED, enlarged, enlarged_calibration


@pytest.mark.slow  # it starts interpreters
def test_what_needs_more_weighs_more_and_what_was_there_nothing() -> None:
    paper = PROFILES["paper"]
    settings = [Setting(paper), Setting(replace(paper, stride_px=8)), Setting(PROFILES["fast"])]
    found = peak_memory(settings, enlarged_calibration(), [enlarged(TOUCHED)], lambda *_: None)
    fine, coarse, fast = found
    assert fine > coarse + 10  # a dozen complex maps of 440 x 440
    assert all(0 < mib < 300 for mib in (coarse, fast))
