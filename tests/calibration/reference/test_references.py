from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support import bad_pictures
from support.calibrated_sensor import (
    HALF,
    TACTIP,
    calibrated,
    loaded,
    pressed,
    references,
    sensor_of,
    simulated,
    step,
    unloaded,
)
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.findings import FindingCode
from tacshade_edge.calibration.reference.references import (
    PATCH_GREY,
    PROFILE,
    Distance,
    Followed,
    beyond,
    bounds,
    follow,
    g_change,
    rezero,
)
from tacshade_edge.calibration.reference.stillness import block_means, motion_grey, stands_still
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.reasons import ReasonCode, code_of
from tacshade_edge.sensor.frame_check.camera_drift import Drift
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, U8, Calibration, Frame
from tools.testbed.simulator.families import OtherSensor, other_model

pytestmark = pytest.mark.slow

SENSOR = sensor_of(HALF)


def test_light_at_the_rim_is_no_load() -> None:
    """LED rings make the skin next to them brighter:
    its profile rises by itself over the last two of twelve rings.
    """
    sensor = OtherSensor(other_model(33))
    calibrate(sensor_of(sensor.model), [sensor.frame((), 5).image])  # not refused
    pressed = sensor.frame(
        (Press(OBJECTS["ball"](), 0.0, 0.0, 3.0, 0.0, skin_scale(sensor.model.geometry)),), 5
    ).image
    with pytest.raises(ConfigError, match="seems pressed"):
        calibrate(sensor_of(sensor.model), [pressed])


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_a_load_is_distinguished_from_none_on_other_sensors(seed: int) -> None:
    """Of 32 loads 3 mm deep `python -m tools.studies.calibration --sensors 30 --detect 16 --first
    8400` misses none.
    """
    model = random_model(seed, 240, 320)
    calibrate(sensor_of(model), references(model, 3))  # not refused
    for x_mm in (0.0, 5.0):
        with pytest.raises(ConfigError, match="seems pressed"):
            calibrate(sensor_of(model), loaded(3.0, x_mm, model))


def test_a_square_lattice_is_no_load() -> None:
    """Its rings are uneven at four places."""
    for seed in (40, 44, 62):
        sensor = OtherSensor(other_model(seed))
        made = calibrate(sensor_of(sensor.model), [sensor.frame((), 5).image])  # not refused
        assert not any("pressed" in sentence(warning) for warning in made.warnings)


def test_noise_is_measured_from_enough_references() -> None:
    noisy = [camera_faults.noise(image, 12, k) for k, image in enumerate(references())]
    assert calibrate(SENSOR, noisy).calibration.noise_grey > 1.5 * calibrated(count=0).noise_grey
    (warning,) = calibrate(SENSOR, references()[:1]).warnings
    assert sentence(warning).startswith("references: found 1, expected 5 to measure noise")


def test_references_that_differ_from_each_other() -> None:
    others = list(references()[1:])
    (warning,) = calibrate(
        SENSOR, [camera_faults.shift(references()[0], 0, 1), *others[:3]]
    ).warnings[:1]
    assert sentence(warning) == "reference 2: the image moved by 1.0 px compared with reference 1"
    with pytest.raises(
        ConfigError,
        match=r"reference 3: the image moved by 5\.0 px since reference 1; fasten the camera",
    ):
        calibrate(SENSOR, [*others[:2], camera_faults.shift(others[2], 0, 5)])
    one_loaded = [*others, simulated(HALF).frame((Press(ball(6.0), 3, 2, 1.5),), 9).image]
    with pytest.raises(ConfigError, match="seems pressed in reference 5"):
        calibrate(SENSOR, one_loaded)
    allowed = calibrate(SENSOR, one_loaded, allow_loaded_reference=True)
    assert FindingCode.PRESSED_IMAGES in {warning.code for warning in allowed.warnings}


def test_a_new_reference_keeps_everything_else() -> None:
    dimmer = [camera_faults.gain(unloaded(noise_seed=60 + k), 0.8) for k in range(3)]
    renewed = rezero(calibrated(), dimmer)
    assert renewed.crc32 == 0
    assert renewed.reference_grey.mean() < 0.85 * calibrated().reference_grey.mean()
    for name in ("geometry", "polarity", "pitch_px", "alpha", "fit"):
        assert getattr(renewed, name) == getattr(calibrated(), name)
    assert renewed.factors == calibrated().factors
    image = pressed("ball", 3.0).image
    found = make_reconstructor(renewed, PROFILES["fast"]).step(
        Frame(0, 0, 0, camera_faults.gain(image, 0.8))
    )
    assert found.depth_max_mm == pytest.approx(step("fast", image).depth_max_mm, rel=0.1)


@pytest.mark.parametrize(
    ("images", "reason"),
    [
        ([], "no image"),
        ([unloaded() * 0], "rejected the reference: black"),
        ([unloaded(), unloaded()[:-1]], "rejected the reference: size"),
        (loaded(3.0, 6.0), "rejected the reference: .*seems pressed"),
        (
            [camera_faults.shift(unloaded(), 0, 4)] * 3,
            "rejected the reference: the camera has moved by 4.0 px",
        ),
        (
            [bad_pictures.defocus(unloaded(), 2.5)] * 3,
            "found 0.* times the old reference's contrast",
        ),
    ],
    ids=["none", "black", "size", "load", "moved", "blurred"],
)
def test_a_new_reference_that_cannot_be_used(images: list[U8], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        rezero(calibrated(), images)


def test_a_load_may_be_allowed() -> None:
    assert rezero(calibrated(), loaded(3.0, 6.0), allow_loaded=True).crc32 == 0


@pytest.mark.parametrize("x_mm", [0.0, 5.0])
def test_a_reference_under_load_is_refused_or_allowed(x_mm: float) -> None:
    with pytest.raises(ConfigError, match=r"seems pressed.*; take the references again"):
        calibrate(SENSOR, loaded(3.0, x_mm))
    (warning,) = calibrate(SENSOR, loaded(3.0, x_mm), allow_loaded_reference=True).warnings
    assert "seems pressed" in sentence(warning)


def blocks(depths_mm: list[float], seed: int) -> list[F32]:
    presses = [
        (Press(ball(4.0), 5.0, 2.0, depth_mm),) if depth_mm else () for depth_mm in depths_mm
    ]
    return [
        block_means(to_grey(simulated(HALF).frame(press, seed + k).image))
        for k, press in enumerate(presses)
    ]


def test_a_held_press_stands_still_and_a_moved_one_does_not() -> None:
    rest = motion_grey(blocks([0.0] * 10, 0))
    assert stands_still(motion_grey(blocks([2.0] * 10, 100)), rest)
    assert not stands_still(motion_grey(blocks([2.0] * 5 + [2.1] * 5, 200)), rest)


@given(level=st.integers(0, 40), shape=st.tuples(st.integers(8, 50), st.integers(8, 50)))
def test_a_light_that_flickers_moves_nothing(level: int, shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 200, shape).astype(np.uint8)
    first, second = block_means(image), block_means(image + np.uint8(level))
    assert first.shape == (shape[0] // 8, shape[1] // 8)
    assert motion_grey([first, second]) == pytest.approx(0.0, abs=1e-3)


IMAGES = 10
STEP_MM = 0.02
DISC = HALF.row_c, HALF.col_c, HALF.disc_radius_px


def rest(seed: int = 50, model: SensorModel = HALF) -> list[U8]:
    return [unloaded(model, seed + k) for k in range(IMAGES)]


def patch_grey(old: Calibration, new: Calibration) -> float:
    return g_change(Preprocessor(old, PROFILE), Preprocessor(new, PROFILE))[1]


def follow_slowly(
    change: Callable[[U8, float], U8], steps: int = 12
) -> tuple[Calibration, Followed]:
    """The reference that was followed while `change` went from 0 to 1, and the last look."""
    origin = current = calibrated(count=0)
    looked = Followed(None, None, None)
    for k in range(1, steps + 1):
        looked = follow(
            origin, current, [change(image, k / steps) for image in rest(50 + IMAGES * k)]
        )
        current = looked.calibration or current
    return current, looked


def test_a_still_picture_is_not_worth_a_renewal() -> None:
    current = calibrated(count=0)
    looked = follow(current, current, rest(60))
    assert looked.calibration is looked.reason is None
    assert looked.distance is not None
    assert looked.distance.drift.light == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    "change",
    [
        lambda image, part: camera_faults.uneven(image, *DISC, 0.2 * part, 30),
        lambda image, part: bad_pictures.warm(image, *DISC[:2], 0.4 * part),
    ],
    ids=["one lamp ages", "warms up"],
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
    assert (current.noise_grey, current.geometry, current.fit) == (
        origin.noise_grey,
        origin.geometry,
        origin.fit,
    )


def faded(image: U8, part: float) -> U8:
    """A marker that is well inside fades."""
    pitch_px = calibrated(count=0).pitch_px
    grey = cv2.GaussianBlur(to_grey(rest()[0]), (0, 0), 0.2 * pitch_px)
    rows, cols = np.ogrid[: grey.shape[0], : grey.shape[1]]
    near = np.hypot(rows - HALF.row_c - 30, cols - HALF.col_c) < 15
    row, col = np.unravel_index(int(np.argmax(np.where(near, grey, 0))), grey.shape)
    covered = camera_faults.speck(image, float(row), float(col), 0.35 * pitch_px).astype(np.float32)
    return np.asarray(np.rint(image + part * (covered - image)), np.uint8)


def moving(image: U8, part: float) -> U8:
    matrix = np.array(((1.0, 0.0, 2.0 * part), (0.0, 1.0, 0.0)))
    return np.asarray(
        cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        (faded, {ReasonCode.PATCH_CHANGED}),
        (lambda image, part: bad_pictures.defocus(image, 0.1 + 2 * part), {ReasonCode.LIGHT_DRIFT}),
        (moving, {ReasonCode.CAMERA_SHIFT, ReasonCode.PATCH_CHANGED}),
        (
            lambda image, part: camera_faults.uneven(image, *DISC, 0.6 * part, 0),
            {ReasonCode.LIGHT_DRIFT},
        ),
    ],
    ids=["a marker fades", "blurs", "the camera moves", "a lamp dies"],
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


@pytest.mark.parametrize(("model", "name", "x_mm"), [(HALF, "edge", 0.0), (TACTIP, "cone", 4.0)])
def test_an_object_laid_on_over_hours_is_found_as_one_that_comes_at_once(
    name: str, x_mm: float, model: SensorModel
) -> None:
    """A fiftieth of a millimetre at a time: contact is found at most 0.15 mm later,
    and a depth is 0.07 mm off.
    """
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


def test_what_cannot_be_compared_is_not_followed() -> None:
    origin = calibrated(count=0)
    for image, code in ((rest()[0][:-2], ReasonCode.SIZE), (rest()[0] * 0, ReasonCode.BLACK)):
        looked = follow(origin, origin, [image])
        assert code_of(looked.reason) == code.value
        assert looked.distance is None


def test_every_bound_is_stated_and_kept() -> None:
    disc = calibrated(count=0).geometry.disc
    stated, still = bounds(disc), Drift(still_part=1.0)
    over = {
        name: (0.99 if name in ("light_low", "contrast") else 1.01) * bound
        for name, bound in stated.items()
    }
    assert beyond(Distance(still, 0.0, 0.0), disc) is None
    assert beyond(Distance(replace(still, row_px=over.pop("shift_px")), 0.0, 0.0), disc)
    assert beyond(Distance(still, -over.pop("common_grey"), 0.0), disc)
    assert beyond(Distance(still, 0.0, over.pop("patch_grey")), disc)
    for name, value in over.items():
        field = "light" if name.startswith("light") else name
        assert beyond(Distance(replace(still, **{field: value}), 0.0, 0.0), disc), name
    assert code_of(beyond(Distance(Drift(), 0.0, 0.0), disc)) == "reference_invalid"
