"""Images of any size, discs cut by the border, of a few pixels or none, and every length, angle, α
and factor that may be stated: what can be measured is, what cannot is refused, nothing breaks.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.built_sensor import built_calibration, marked
from support.examples import examples
from support.extremes import EXTREME_IMAGES, noise
from support.soundness import always_asked, sound_step
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.sensor.depth.learned import DEEPEST_RADII
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Disc, Geometry

ROWS, COLS, PITCH_PX = 96, 128, 8.0
WHOLE = Disc(48, 64, 40)
DISCS = {
    "cut above": Disc(20, 64, 40),
    "cut on two sides": Disc(48, 64, 60),
    "a corner": Disc(0, 0, 40),
    "a sliver": Disc(-38, 64, 40.5),
    "3 px": Disc(48, 64, 3),
    "1 px": Disc(48, 64, 0.4),
    "between pixels": Disc(48.5, 64.5, 0.4),
    "outside": Disc(-100, -100, 40),
    "all around": Disc(48, 64, 5000),
    "a straight edge": Disc(5000, 64, 4990),
}
# An image may lie between the middles of cells as wide as it.
FAR = {"all around", "a straight edge"}
EMPTY = {"between pixels", "outside"}
SMALL = [(1, 1), (2, 3), (8, 8), (9, 8), (17, 300), (64, 64)]
# `paper`, with its iterations over every pixel, takes ten seconds for a larger image.
LARGE_CASES = [(479, 641, profile) for profile in PROFILES] + [(3072, 4096, "fast")]


def pressed(disc: Disc, pitch_px: float = PITCH_PX) -> U8:
    return marked(ROWS, COLS, pitch_px, disc, pressed_px=0.5 * min(disc.radius_px, 60))


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("name", DISCS)
def test_every_disc_is_borne(profile: str, name: str) -> None:
    calibration = built_calibration(ROWS, COLS, disc=DISCS[name], pitch_px=PITCH_PX)
    made = make_reconstructor(calibration, PROFILES[profile])
    free = sound_step(made, calibration.reference_grey)
    assert not free.contact
    if name in EMPTY:
        assert free.reason is not None
        assert free.reason.code is ReasonCode.NO_DISC
    elif name not in FAR:
        assert np.isfinite(free.height.height_mm).any()
    for image in (noise(1), EXTREME_IMAGES["spot"], EXTREME_IMAGES["step, axis 0"]):
        sound_step(made, image(ROWS, COLS))
    found = sound_step(always_asked(calibration, profile), pressed(DISCS[name]))
    if name in (
        "cut above",
        "cut on two sides",
    ):  # of a corner too little is seen to distinguish skin from what is not
        assert found.contact


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("pitch_px", [0.3, 2.0, 500.0])
def test_every_pitch_is_borne(profile: str, pitch_px: float) -> None:
    made = always_asked(built_calibration(ROWS, COLS, disc=WHOLE, pitch_px=pitch_px), profile)
    for image in (pressed(WHOLE, pitch_px), pressed(WHOLE), noise(1)(ROWS, COLS)):
        sound_step(made, image)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@given(
    skin_radius_mm=st.floats(1, 200),
    camera_distance_mm=st.none() | st.floats(0, 1000, exclude_min=True),
    visible_half_angle_deg=st.floats(5, 85),
    alpha=st.floats(0, 10000, exclude_min=True),
    place=st.tuples(st.floats(-0.3, 1.3), st.floats(-0.3, 1.3), st.floats(0.05, 1.5)),
    pitch=st.floats(0.05, 1.0),
    size=st.tuples(st.integers(1, 130), st.integers(1, 130)),
)
@examples(75)
def test_every_sensor_that_may_be_stated_is_borne(
    profile: str,
    skin_radius_mm: float,
    camera_distance_mm: float | None,
    visible_half_angle_deg: float,
    alpha: float,
    place: tuple[float, float, float],
    pitch: float,
    size: tuple[int, int],
) -> None:
    """The ranges of SENSOR.yaml, and any image and circle."""
    rows, cols = size
    disc = Disc(place[0] * rows, place[1] * cols, place[2] * max(rows, cols))
    pitch_px = max(pitch * disc.radius_px, 0.3)
    built = built_calibration(rows, cols, disc=disc, pitch_px=pitch_px, alpha=alpha)
    geometry = Geometry(skin_radius_mm, camera_distance_mm, visible_half_angle_deg, disc)
    made = always_asked(replace(built, geometry=geometry), profile)
    sound_step(made, marked(rows, cols, pitch_px, disc, pressed_px=0.5 * disc.radius_px))


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [5e-324, 1e-3, 15.0, 9e5])
def test_paper_is_as_high_as_alpha_says_and_never_deeper_than_the_skin(alpha: float) -> None:
    calibration = built_calibration(ROWS, COLS, disc=WHOLE, pitch_px=PITCH_PX, alpha=alpha)
    result = sound_step(make_reconstructor(calibration, PROFILES["paper"]), pressed(WHOLE))
    stated_mm = min(alpha * calibration.geometry.mm_per_px, calibration.geometry.skin_radius_mm)
    assert np.nanmax(result.height.height_mm) == pytest.approx(stated_mm, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2e-6, 3.0, 1e5])
@pytest.mark.parametrize("profile", [p.name for p in PROFILES.values() if p.network])
def test_a_factor_scales_and_never_breaks(profile: str, factor: float) -> None:
    calibration = built_calibration(ROWS, COLS, disc=WHOLE, pitch_px=PITCH_PX)
    plain = sound_step(make_reconstructor(calibration, PROFILES[profile]), pressed(WHOLE))
    scaled = replace(calibration, factors={profile: factor})
    result = sound_step(make_reconstructor(scaled, PROFILES[profile]), pressed(WHOLE))
    expected_mm = min(factor * float(np.nanmax(plain.height.height_mm)), 20.0)
    assert np.nanmax(result.height.height_mm) == pytest.approx(expected_mm, rel=1e-5, abs=1e-30)
    assert result.contact
    assert result.saturated == (result.depth_max_mm > DEEPEST_RADII * 20)


def sensor_image(rows: int, cols: int) -> U8:
    disc = Disc((rows - 1) / 2, (cols - 1) / 2, 0.45 * min(rows, cols))
    image = marked(rows, cols, max(disc.radius_px / 10, 2.0), disc)
    return np.where(disc_mask(rows, cols, disc), image, np.uint8(5))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("rows", "cols"), SMALL)
def test_a_small_image_is_borne(profile: str, rows: int, cols: int) -> None:
    calibration = built_calibration(rows, cols, reference=sensor_image(rows, cols))
    made = make_reconstructor(calibration, PROFILES[profile])
    assert not sound_step(made, calibration.reference_grey).contact
    for image in (noise(1), EXTREME_IMAGES["white spike"], EXTREME_IMAGES["checkerboard 2 px"]):
        sound_step(made, image(rows, cols))


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols", "profile"), LARGE_CASES)
def test_a_press_is_found_at_every_size(rows: int, cols: int, profile: str) -> None:
    calibration = built_calibration(rows, cols)
    made = make_reconstructor(calibration, PROFILES[profile])
    disc = calibration.geometry.disc
    assert not sound_step(made, calibration.reference_grey).contact
    pressed = marked(rows, cols, calibration.pitch_px, disc, pressed_px=0.4 * disc.radius_px)
    result = sound_step(made, pressed)
    assert result.contact
    x_mm, y_mm, _ = result.objects[0].centroid_mm
    assert np.hypot(x_mm, y_mm) < 2.0  # of 20


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols", "every"), [(8, 8, 1), (96, 128, 3)])
def test_no_extreme_image_is_taken_for_a_sensor(rows: int, cols: int, every: int) -> None:
    for name, image in list(EXTREME_IMAGES.items())[::every]:
        with pytest.raises(ConfigError) as refusal:
            calibrate(
                StatedSensor(20.0, 30.0, 50.0, "bright"), [np.ascontiguousarray(image(rows, cols))]
            )
        assert "\n" not in str(refusal.value), name
        assert not re.search("nan|inf", str(refusal.value)), name
