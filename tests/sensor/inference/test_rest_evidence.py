"""The limits that images of the untouched skin set, for every profile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from support.calibrated_sensor import HALF, calibrated, pressed, simulated, unloaded
from support.networks import shared_networks
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.sensor.contact.rest import LEAST_FRAMES
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.inference.rest_evidence import LearntRest, learn_rest
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Frame

__all__ = ["shared_networks"]
pytestmark = pytest.mark.slow


def untouched(count: int) -> Iterator[tuple[str, U8]]:
    for k in range(count):
        yield f"rest {k}", simulated(HALF).frame((), 700 + k).image


@pytest.fixture(scope="module")
def learnt() -> LearntRest:
    glare = camera_faults.glare(unloaded(), 118, 140, 14)
    return learn_rest(calibrated(HALF, 0), [*untouched(12), ("glare", glare)], 1e-3)


def test_every_profile_with_a_network_has_limits(learnt: LearntRest) -> None:
    assert set(learnt.limits) == {name for name, one in PROFILES.items() if one.network}
    assert {(one.frames, one.false_contacts) for one in learnt.limits.values()} == {(12, 1e-3)}
    (line,) = learnt.left_out
    assert line.startswith("glare: glare hides ")


@pytest.mark.parametrize("profile", ["fast", "balanced", "accurate"])
def test_a_faint_press_is_found_and_another_untouched_frame_is_not(
    learnt: LearntRest, profile: str
) -> None:
    made = make_reconstructor(replace(calibrated(HALF, 0), rest=learnt.limits), PROFILES[profile])
    for k in range(3):
        free = made.step(Frame(k, 0, 0, simulated(HALF).frame((), 800 + k).image))
        assert not free.contact
        assert not free.touched
    for name, depth_mm in (("ball", 0.3), ("plate", 0.3)):
        faint = made.step(Frame(9, 0, 0, pressed(name, depth_mm).image))
        assert faint.contact or faint.touched


def test_too_few_images_are_refused_with_the_reason_of_one() -> None:
    dark = [(f"dark {k}", camera_faults.gain(unloaded(), 0.2)) for k in range(LEAST_FRAMES)]
    with pytest.raises(ConfigError, match=r"found 0 usable images .*\(dark 0: light: .*at least 8"):
        learn_rest(calibrated(HALF, 0), dark)
