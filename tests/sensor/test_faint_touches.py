"""Touches that a map does not show, and what is none: whole frames, from image to result."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import (
    HALF,
    calibrated,
    pressed,
    simulated,
    step,
    unloaded,
)
from support.networks import saying
from support.soundness import assert_nothing
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.rest import Evidence
from tacshade_edge.sensor.depth.learned import fold
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.inference.network import load_network, make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, U8, Frame, Need, RestLimits
from tools.testbed.simulator.families import released


def test_a_light_press_is_felt_and_a_touch_beside_the_disc_is_not_invented() -> None:
    assert step("fast", pressed("ball", 1.0).image).contact
    beside = simulated(HALF).frame((Press(OBJECTS["ball"](), 19.0, 0.0, 1.0),), 3)
    assert step("fast", beside.image).depth_max_mm < beside.skin.height_mm.max()


def test_labels_are_learnt_from_touches_that_the_map_does_not_show() -> None:
    taken: list[F32] = []
    made = Reconstructor(calibrated(), PROFILES["fast"], load_network("fast"), touch=taken.append)
    for _ in range(2):
        result = made.step(Frame(0, 0, 0, pressed("ball", 0.1, HALF, 2.0).image))
        assert not result.contact
        assert result.touch is None
    assert len(taken) == 2
    assert made.changed_part > 0


def test_labels_are_learnt_of_less_change_than_a_contact_needs() -> None:
    taken: list[F32] = []
    made = Reconstructor(calibrated(), PROFILES["fast"], load_network("fast"), touch=taken.append)
    frame = Frame(0, 0, 0, pressed("ball", 2.0).image)
    assert made.step(frame).contact
    made.gate_part = made.changed_part + 0.01
    assert not made.step(frame, need=Need.SHEAR).contact
    assert not made.step(frame).contact
    assert len(taken) == 2


def test_what_a_release_leaves_in_the_skin_is_no_contact() -> None:
    for x_mm in (0.0, 5.0):
        left = released(simulated(HALF), (Press(OBJECTS["ball"](), x_mm, 0.0, 4.0),), 0.05, 3)
        assert left.skin.height_mm.max() >= 0.2
        assert not step("accurate", left.image).contact


def with_limits(
    height_mm: float, local_change: float = 0.9, changed_part: float = 0.9, profile: str = "fast"
) -> Reconstructor:
    limits = RestLimits(60, 1e-4, height_mm, local_change, changed_part)
    return make_reconstructor(
        replace(calibrated(HALF, 0), rest={profile: limits}), PROFILES[profile]
    )


@pytest.mark.parametrize(
    ("limits", "why"),
    [((0.001,), "the network finds"), ((5.0, 0.001), "in a place"), ((5.0, 0.9, 0.0), "picture")],
)
def test_evidence_beyond_rest_is_a_touch_of_unknown_depth(
    limits: tuple[float, ...], why: str
) -> None:
    faint = Frame(0, 0, 0, pressed("ball", 0.1, HALF, 2.0).image)
    unmoved = with_limits(5.0).step(faint)
    assert (unmoved.contact, unmoved.touched, unmoved.degraded) == (False, False, None)
    made = with_limits(*limits)
    for _ in range(2):  # the second is unchanged, and no less a touch
        result = made.step(faint)
        assert_nothing(result, made.rays.inside)
        assert result.valid
        assert result.touched
        assert result.degraded is not None
        assert result.degraded.code is ReasonCode.TOUCH_UNMEASURED
        assert why in result.degraded.text
    assert made.step(faint, need=Need.CONTACT) is not None
    free = made.step(Frame(1, 0, 0, unloaded()))
    assert (free.touched, free.contact, free.degraded) == (False, False, None)


def test_a_contact_with_a_map_stays_one() -> None:
    for limit in (0.0, 50.0):
        result = with_limits(limit).step(Frame(0, 0, 0, pressed("ball", 1.0).image))
        assert result.contact
        assert not result.touched


def test_what_glare_raises_is_no_touch() -> None:
    made = with_limits(0.0, 0.0, 0.0)
    assert made.step(Frame(0, 0, 0, pressed("ball", 0.1, HALF, 2.0).image)).touched
    result = made.step(Frame(0, 0, 0, camera_faults.glare(unloaded(), 118, 140, 14)))
    assert not result.touched
    assert result.degraded is not None
    assert result.degraded.code is ReasonCode.GLARE


def test_a_dent_is_no_touch_for_a_while_after_a_contact() -> None:
    made = with_limits(0.001, 0.001)
    deep, dent = pressed("ball", 3.0).image, pressed("ball", 0.1, HALF, 2.0).image
    assert made.step(Frame(0, 10**9, 0, deep)).contact
    for k in range(2):
        left = made.step(Frame(1 + k, 2 * 10**9 + k, 0, dent))
        assert (left.contact, left.touched, left.degraded) == (False, False, None)
    assert made.step(Frame(3, 5 * 10**9, 0, dent)).touched
    assert made.step(Frame(4, 6 * 10**9, 0, deep), need=Need.CONTACT) is None
    assert not made.step(Frame(5, 7 * 10**9, 0, dent)).touched


def swayed(image: U8, degrees: float) -> U8:
    """The pattern turned about the disc's middle, as by a tip that sways;
    what lies around stays.
    """
    disc = HALF.geometry.disc
    turn = cv2.getRotationMatrix2D((disc.col_c, disc.row_c), degrees, 1.0)
    return np.asarray(
        cv2.warpAffine(image, turn, image.shape[1::-1], flags=cv2.INTER_CUBIC), np.uint8
    )


def test_a_tip_that_sways_is_no_contact() -> None:
    said = np.stack(
        [np.full((disc_map.CELLS, disc_map.CELLS), value, np.float32) for value in (1, 3)]
    )
    made = Reconstructor(calibrated(HALF, 0), PROFILES["balanced"], saying(fold(said, 4)))
    assert made.step(Frame(0, 0, 0, pressed("ball", 2.0).image)).contact
    result = made.step(Frame(1, 0, 0, swayed(unloaded(), 2.0)))
    assert_nothing(result, made.rays.inside)
    assert result.valid
    assert not result.touched
    assert result.degraded is not None
    assert result.degraded.code is ReasonCode.TIP_MOVING


def test_evidence_is_measured_of_an_image_behind_the_gate() -> None:
    made = with_limits(0.0)
    free, touched = made.evidence(unloaded()), made.evidence(pressed("ball", 1.0).image)
    assert isinstance(free, Evidence)
    assert isinstance(touched, Evidence)
    assert free.height_mm < 0.02 < 0.1 < touched.height_mm
    assert free.local_change < 0.02 < 0.05 < touched.local_change
    assert free.changed_part < 0.03 < touched.changed_part
    assert isinstance(made.evidence(np.zeros_like(unloaded())), Reason)
    assert isinstance(made.evidence(unloaded()[:-2]), Reason)
