from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import HALF, TACTIP, calibrated, simulated, unloaded

from tacshade_edge.core.calibration.reference.references import (
    COMMON_GREY,
    PATCH_GREY,
    PROFILE,
    Distance,
    Followed,
    beyond,
    bounds,
    follow,
    g_change,
)
from tacshade_edge.core.frame_check.camera import Drift
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.simulator import camera_faults
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.types import U8, Calibration, Frame

pytestmark = pytest.mark.slow

IMAGES = 10
STEP_MM = 0.02
DISC = HALF.row_c, HALF.col_c, HALF.disc_radius_px


def rest(seed: int = 50, model: SensorModel = HALF) -> list[U8]:
    return [unloaded(model, seed + k) for k in range(IMAGES)]


def patch_grey(old: Calibration, new: Calibration) -> float:
    return g_change(Preprocessor(old, PROFILE), Preprocessor(new, PROFILE))[1]


def follow_slowly(change: Callable[[U8, float], U8], steps: int = 12) -> tuple[Calibration, Followed]:
    """The reference that was followed while `change` went from 0 to 1, and the last look."""
    origin = current = calibrated(count=0)
    looked = Followed(None, None, None)
    for k in range(1, steps + 1):
        looked = follow(origin, current, [change(image, k / steps) for image in rest(50 + IMAGES * k)])
        current = looked.calibration or current
    return current, looked


def test_a_still_picture_is_not_worth_a_renewal() -> None:
    current = calibrated(count=0)
    looks = [follow(current, current, rest(60 + 10 * k)) for k in range(5)]
    assert [look.calibration for look in looks] == [None] * 5
    assert [look.reason for look in looks] == [None] * 5
    assert looks[0].distance is not None
    assert looks[0].distance.drift.light == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    "change",
    [
        lambda image, part: camera_faults.gain(image, 1 - 0.15 * part),
        lambda image, part: camera_faults.uneven(image, *DISC, 0.2 * part, 30),
        lambda image, part: camera_faults.warm(image, *DISC[:2], 0.4 * part),
    ],
    ids=["light ages", "one lamp ages", "warms up"],
)
def test_slow_change_is_followed(change: Callable[[U8, float], U8]) -> None:
    origin = calibrated(count=0)
    current, looked = follow_slowly(change)
    assert looked.reason is None
    then = follow(origin, origin, [change(image, 1.0) for image in rest(900)]).calibration
    assert then is not None
    assert patch_grey(current, then) < 3
    levels = [float(np.mean(to_grey(np.asarray(c.reference_grey)))) for c in (current, then)]
    assert levels[0] == pytest.approx(levels[1], rel=0.02)
    assert (current.noise_grey, current.geometry, current.fit) == (origin.noise_grey, origin.geometry, origin.fit)


@cache
def marker_px() -> tuple[float, float]:
    """Row and column of a marker that is well inside."""
    grey = cv2.GaussianBlur(to_grey(rest()[0]), (0, 0), 0.2 * calibrated(count=0).pitch_px)
    rows, cols = np.ogrid[: grey.shape[0], : grey.shape[1]]
    near = np.hypot(rows - HALF.row_c - 30, cols - HALF.col_c) < 15
    row, col = np.unravel_index(int(np.argmax(np.where(near, grey, 0))), grey.shape)
    return float(row), float(col)


def speckled(radius_pitches: float) -> Callable[[U8, float], U8]:
    def change(image: U8, part: float) -> U8:
        radius_px = radius_pitches * calibrated(count=0).pitch_px
        row, col = marker_px()
        covered = camera_faults.speck(image, row, col, radius_px).astype(np.float32)
        return np.asarray(np.rint(image + part * (covered - image)), np.uint8)

    return change


def torn(image: U8, part: float) -> U8:
    """From the middle down the skin slips sideways."""
    return camera_faults.torn(image, image, round(HALF.row_c), round(6 * part))


def moving(image: U8, part: float) -> U8:
    matrix = np.array(((1.0, 0.0, 2.0 * part), (0.0, 1.0, 0.0)))
    return np.asarray(cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE), np.uint8)


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        (speckled(0.35), {ReasonCode.PATCH_CHANGED}),
        (speckled(1.5), {ReasonCode.PATCH_CHANGED}),
        (torn, {ReasonCode.PATCH_CHANGED, ReasonCode.TORN, ReasonCode.CAMERA_SHIFT, ReasonCode.SURROUND}),
        (lambda image, part: camera_faults.defocus(image, 0.1 + 2 * part), {ReasonCode.LIGHT_DRIFT}),
        (lambda image, part: camera_faults.gain(image, 1 - 0.5 * part), {ReasonCode.LIGHT_DRIFT}),
        (moving, {ReasonCode.CAMERA_SHIFT, ReasonCode.PATCH_CHANGED}),
        (lambda image, part: camera_faults.uneven(image, *DISC, 0.6 * part, 0), {ReasonCode.LIGHT_DRIFT}),
    ],
    ids=["a marker fades", "a stain", "torn", "blurs", "goes dark", "the camera moves", "a lamp dies"],
)
def test_damage_is_not_followed_however_slowly_it_comes(
    change: Callable[[U8, float], U8], codes: set[ReasonCode]
) -> None:
    origin = calibrated(count=0)
    current, looked = follow_slowly(change)
    assert looked.reason is not None
    assert looked.reason.code in codes
    assert looked.calibration is None
    assert patch_grey(origin, current) <= PATCH_GREY
    # What was fixed is followed again.
    again = follow(origin, current, rest(950))
    assert again.reason is None
    assert patch_grey(origin, again.calibration or current) < 3


@pytest.mark.parametrize(
    ("model", "name", "x_mm"),
    [
        *((HALF, *laid) for laid in (("ball", 4.0), ("edge", 0.0), ("cone", 4.0))),
        (TACTIP, "cone", 4.0),
    ],
)
def test_an_object_laid_on_over_hours_is_found_as_one_that_comes_at_once(
    name: str, x_mm: float, model: SensorModel
) -> None:
    """A fiftieth of a millimetre at a time: contact is found at most 0.15 mm later, and a depth is 0.07 mm off."""
    origin = calibrated(model, 0)

    def images(depth_mm: float, seed: int = 0) -> list[U8]:
        press = Press(OBJECTS[name](), x_mm, 1.0, depth_mm)
        return [simulated(model).frame((press,), seed + k).image for k in range(IMAGES)]

    def touched(reconstructor: Reconstructor, seen: list[U8]) -> bool:
        return any(reconstructor.step(Frame(0, 0, 0, image)).contact for image in seen[:2])

    at_once_mm: float | None = None
    current = origin
    first = following = make_reconstructor(origin, PROFILES["balanced"])
    for k in range(-5, 60):
        depth_mm = k * STEP_MM
        seen = images(depth_mm, 100 + IMAGES * (k + 50))
        if at_once_mm is None and touched(first, seen):
            at_once_mm = depth_mm
        if touched(following, seen):
            break
        if renewed := follow(origin, current, seen).calibration:
            current, following = renewed, make_reconstructor(renewed, PROFILES["balanced"])
    assert depth_mm - (depth_mm if at_once_mm is None else at_once_mm) <= 0.15
    deep = Frame(0, 0, 0, images(1.5)[0])
    depths = [reconstructor.step(deep).depth_max_mm for reconstructor in (first, following)]
    assert depths[1] == pytest.approx(depths[0], abs=0.07)


def test_a_sensor_that_trembles_does_not_raise_its_gate() -> None:
    origin = calibrated(count=0)
    trembling = [camera_faults.noise(camera_faults.gain(image, 0.9), 20, k) for k, image in enumerate(rest())]
    renewed = follow(origin, origin, trembling)
    assert renewed.calibration is None or renewed.calibration.noise_grey == origin.noise_grey


def test_what_cannot_be_compared_is_not_followed() -> None:
    origin = calibrated(count=0)
    wrong = follow(origin, origin, [rest()[0][:-2]])
    assert wrong.reason is not None
    assert (wrong.reason.code, wrong.distance) == (ReasonCode.SIZE, None)
    black = follow(origin, origin, [rest()[0] * 0])
    assert black.reason is not None
    assert black.reason.code is ReasonCode.BLACK


def test_every_bound_is_told_and_kept() -> None:
    disc = calibrated(count=0).geometry.disc
    told, still = bounds(disc), Drift(still_part=1.0)
    assert beyond(Distance(still, 0.0, 0.0), disc) is None
    over = {
        "shift_px": (replace(still, row_px=1.01 * told["shift_px"]), 0.0, 0.0),
        "moved_px": (replace(still, moved_px=1.01 * told["moved_px"]), 0.0, 0.0),
        "light_low": (replace(still, light=0.99 * told["light_low"]), 0.0, 0.0),
        "light_high": (replace(still, light=1.01 * told["light_high"]), 0.0, 0.0),
        "uneven": (replace(still, uneven=1.01 * told["uneven"]), 0.0, 0.0),
        "contrast": (replace(still, contrast=0.99 * told["contrast"]), 0.0, 0.0),
        "common_grey": (still, -1.01 * COMMON_GREY, 0.0),
        "patch_grey": (still, 0.0, 1.01 * PATCH_GREY),
    }
    assert set(over) == set(told)
    for name, (drift, common, patch) in over.items():
        assert beyond(Distance(drift, common, patch), disc) is not None, name
    unknown = beyond(Distance(Drift(), 0.0, 0.0), disc)
    assert unknown is not None
    assert unknown.code is ReasonCode.REFERENCE_INVALID
