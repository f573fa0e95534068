"""A picture that `calibrate` takes as a reference is never refused against itself,
nor a skin in other light.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from support.built_sensor import FIELD, PITCH_PX, SIZE, pins_px, sparse_dome
from support.calibrated_sensor import (
    FULL,
    HALF,
    TACTIP,
    random_sensor,
    references,
    simulated,
    unloaded,
)

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.calibration.reference.marker_field import choose_binarisation, find_markers
from tacshade_edge.calibration.reference.pattern import (
    Pattern,
    find_pattern,
    marker_pitch_px,
    mean_image,
    view,
)
from tacshade_edge.calibration.reference.visible_circle import (
    find_disc,
    found_circle_doubt,
    stated_circle_doubt,
    visible_disc,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.render import Print, Renderer, print_features, project
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import chart_to_direction, undeformed
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F64, U8, Bool, Calibration, Disc, Frame, Reconstruction
from tools.testbed.simulator.families import sensor_name

MODELS = {"half": HALF, "tactip": TACTIP, "full": FULL} | {
    f"random {k}": random_sensor(k) for k in range(3)
}


def tip_pitch_px(model: SensorModel) -> float:
    """Mean distance of neighbouring pin tips, projected, in the middle of the disc:
    what the camera sees.
    """
    chart = print_features(model).pin_chart_mm
    along = chart_to_direction(chart[:, 0], chart[:, 1], model.skin_radius_mm)
    tips = along * (model.skin_radius_mm - model.pin_length_pitches * model.pitch_mm)
    seen = project(model.geometry, tips)
    middle = (
        np.hypot(seen[:, 0] - model.col_c, seen[:, 1] - model.row_c) < 0.25 * model.disc_radius_px
    )
    return float(cKDTree(seen).query(seen[middle], 7)[0][:, 1:].mean())


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "half" else pytest.mark.slow) for name in MODELS],
)
def test_the_visible_circle_and_the_pitch_are_found(name: str) -> None:
    model = MODELS[name]
    grey = mean_image([to_grey(image) for image in references(model, 3)])
    disc = find_disc(grey)
    assert np.hypot(disc.row_c - model.row_c, disc.col_c - model.col_c) < 0.5
    assert disc.radius_px == pytest.approx(model.disc_radius_px, rel=0.005)
    assert marker_pitch_px(grey, disc) == pytest.approx(tip_pitch_px(model), rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["other:33", "123"])
def test_neither_a_marker_that_the_rim_cuts_nor_a_coarse_faint_rim_moves_the_circle(
    name: str,
) -> None:
    sensor = sensor_name(name).make()
    disc = find_disc(to_grey(sensor.frame((), 1000).image))
    assert disc.radius_px == pytest.approx(sensor.model.disc_radius_px, rel=0.005)


def disc_of_light() -> U8:
    image = np.zeros((240, 320), np.uint8)
    cv2.circle(image, (160, 120), 90, 200, -1)
    return image


NO_SENSOR = {
    "grey": np.full((240, 320), 128, np.uint8),
    "noise": np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8),
    "ramp": np.tile(np.linspace(0, 255, 320).astype(np.uint8), (240, 1)),
    "one pixel": np.zeros((1, 1), np.uint8),
    "line": np.random.default_rng(3).integers(0, 256, (1, 320), dtype=np.uint8),
    "disc without markers": disc_of_light(),
    "chequers": (np.indices((240, 320)).sum(axis=0) // 8 % 2 * 200 + 20).astype(np.uint8),
}


@pytest.mark.parametrize("name", NO_SENSOR)
def test_what_is_no_sensor_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        marker_pitch_px(NO_SENSOR[name], find_disc(NO_SENSOR[name]))
    assert "reference" in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert "nan" not in str(refusal.value)


def test_the_mean_rounds_and_does_not_wrap() -> None:
    mean = mean_image([np.full((2, 2), v, np.uint8) for v in (255, 255, 254)])
    assert mean.dtype == np.uint8
    assert (mean == 255).all()


@pytest.mark.parametrize("size", [1.0, 0.25, 0.21])
def test_each_pin_is_found_and_no_lamp_is_one(size: float) -> None:
    """Of pictures from 100 px on."""
    image = cv2.resize(sparse_dome(), None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    found = find_markers(image)
    assert found is not None
    true = (pins_px() + 0.5) * size - 0.5
    nearest = np.linalg.norm(found.markers_px[:, None] - true[None], axis=2).min(axis=1)
    assert len(found.markers_px) >= 0.97 * len(true)
    assert nearest.max() < max(0.15 * PITCH_PX * size, 1.0)
    assert found.pitch_px == pytest.approx(PITCH_PX * size, rel=0.06)


@pytest.mark.slow
def test_the_circle_is_where_the_pins_end_not_where_the_lamps_do() -> None:
    """In grey, thresholded, and small."""
    rows, cols = np.ogrid[: SIZE[0], : SIZE[1]]
    near = np.hypot(rows - FIELD.row_c, cols - FIELD.col_c) < 180
    black_and_white: U8 = np.where(near & (sparse_dome() > 60), np.uint8(255), np.uint8(0))
    small = cv2.resize(black_and_white[72:432, 132:492], (100, 100), interpolation=cv2.INTER_AREA)
    for image, scale in ((sparse_dome(), 1.0), (black_and_white, 1.0), (small, 100 / 360)):
        disc = find_disc(image)
        assert disc.radius_px == pytest.approx(FIELD.radius_px * scale, rel=0.07)
        assert marker_pitch_px(image, disc) == pytest.approx(PITCH_PX * scale, rel=0.15)


def test_noise_has_no_markers() -> None:
    rng = np.random.default_rng(0)
    assert find_markers(rng.integers(0, 256, (240, 320), dtype=np.uint8)) is None
    assert find_markers(np.zeros((12, 12), np.uint8)) is None
    soft = cv2.GaussianBlur(rng.normal(100, 60, (480, 640)).astype(np.float32), (0, 0), 4)
    assert find_markers(np.clip(soft, 0, 255).astype(np.uint8)) is None


def test_what_the_markers_fill() -> None:
    image = sparse_dome()
    found = find_markers(image)
    assert found is not None
    assert found.holds(FIELD)
    assert not found.holds(Disc(FIELD.row_c, FIELD.col_c, 0.8 * FIELD.radius_px))
    assert found.filled_part(FIELD, image.shape) > 0.9
    assert found.filled_part(Disc(FIELD.row_c, FIELD.col_c, 283.0), image.shape) < 0.5
    assert found.filled_part(Disc(-500.0, -500.0, 50.0), image.shape) == 0.0


@pytest.mark.parametrize(
    ("noise_grey", "chosen"), [(5.0, "otsu"), (2.5, "otsu"), (0.0, "adaptive")]
)
def test_pins_that_stand_far_apart_are_split_from_the_noise_between_them(
    noise_grey: float, chosen: str
) -> None:
    dome = sparse_dome(noise_grey=noise_grey, contrast_grey=70.0)
    assert choose_binarisation(dome, FIELD, PITCH_PX) == chosen


@pytest.mark.slow
def test_dense_patterns_and_what_has_no_markers_keep_the_mean_around() -> None:
    for model in (HALF, TACTIP):
        grey = to_grey(references(model, 1)[0])
        assert (
            choose_binarisation(
                grey, model.geometry.disc, marker_pitch_px(grey, model.geometry.disc)
            )
            == "adaptive"
        )
    noise = np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8)
    assert choose_binarisation(noise, FIELD, 9.0) == "adaptive"


@pytest.mark.slow
def test_a_blurred_picture_has_less_focus_and_a_dark_one_less_contrast() -> None:
    grey = to_grey(unloaded(FULL))
    pattern, disc = find_pattern(grey), simulated(FULL).model.geometry.disc
    found = (pattern.disc.row_c, pattern.disc.col_c, pattern.disc.radius_px)
    assert found == pytest.approx((disc.row_c, disc.col_c, disc.radius_px), abs=1.5)
    sharp = view(grey, pattern)
    assert sharp.advice == ""
    blurred = [
        view(cv2.GaussianBlur(grey, (0, 0), sigma), pattern).focus for sigma in (1.0, 2.0, 3.0)
    ]
    assert [sharp.focus, *blurred] == sorted([sharp.focus, *blurred], reverse=True)
    dark = view((grey // 8).astype(np.uint8), pattern)
    assert dark.focus == pytest.approx(sharp.focus, rel=0.1)
    assert dark.advice.startswith("too flat")
    bright = view(np.minimum(2.0 * grey, 255).astype(np.uint8), pattern)
    assert bright.saturated_part > 0.05
    assert bright.advice.startswith("too bright")


@pytest.mark.parametrize("shape", [(1, 1), (480, 640), (5, 4000)])
def test_an_empty_picture_has_no_pattern(shape: tuple[int, int]) -> None:
    with pytest.raises(ConfigError):
        find_pattern(np.zeros(shape, np.uint8))


def test_a_disc_outside_of_the_image_shows_nothing() -> None:
    assert view(np.zeros((48, 64), np.uint8), Pattern(Disc(-900.0, 0.0, 10.0), 5.0)).focus == 0.0


SENSOR = StatedSensor(20.0, 25.0, 50.0, "dark")


def calibrated(image: U8, sensor: StatedSensor = SENSOR) -> Calibration:
    return calibrate(sensor, [image], allow_loaded_reference=True).calibration


def step(made: Reconstructor, image: U8) -> Reconstruction:
    return made.step(Frame(0, 0, 0, image))


BASES: dict[str, Callable[[], U8]] = {
    "dome": sparse_dome,
    "half": lambda: to_grey(references(HALF, 1)[0]),
    "tactip": lambda: to_grey(references(TACTIP, 1)[0]),
}
LOOKS = st.lists(
    st.one_of(
        st.builds(lambda gain: lambda grey: np.clip(gain * grey, 0, 255), st.floats(0.1, 3.0)),
        st.builds(
            lambda level: lambda grey: np.where(grey > level, 255.0, 0.0), st.floats(20, 150)
        ),
        st.builds(lambda part: lambda grey: part * grey + (1 - part) * 128, st.floats(0.05, 1.0)),
        st.builds(
            lambda sigma: lambda grey: cv2.GaussianBlur(grey, (0, 0), sigma), st.floats(0.5, 4.0)
        ),
        st.builds(
            lambda sigma: lambda grey: camera_faults.noise(np.uint8(grey), sigma, 1),
            st.floats(0, 40),
        ),
        st.builds(
            lambda part: (
                lambda grey: cv2.resize(grey, None, fx=part, fy=part, interpolation=cv2.INTER_AREA)
            ),
            st.floats(0.45, 1.0),
        ),
    ),
    max_size=3,
)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(
    name=st.sampled_from(sorted(BASES)), looks=LOOKS, polarity=st.sampled_from(["bright", "dark"])
)
def test_a_reference_is_never_refused_against_itself(name: str, looks: list, polarity: str) -> None:
    """By any check of any profile, whatever picture is taken as one."""
    image = BASES[name]().astype(np.float32)
    for look in looks:
        image = look(image).astype(np.float32)
    grey = np.rint(image).astype(np.uint8)
    try:
        calibration = calibrated(grey, replace(SENSOR, polarity=polarity))
    except ConfigError:
        return
    for profile in PROFILES.values():
        result = step(make_reconstructor(calibration, profile), grey)
        assert result.valid, (profile.name, result.reason)
        assert result.degraded is None, (profile.name, result.degraded)
        assert not result.contact, profile.name


@pytest.mark.slow
def test_a_dome_of_sparse_pins_is_calibrated_and_felt() -> None:
    made = make_reconstructor(calibrated(sparse_dome()), PROFILES["balanced"])
    for seed in range(1, 4):
        free = step(made, sparse_dome(seed))
        assert (free.valid, free.contact) == (True, False)
    felt = step(made, sparse_dome(9, pressed=True))
    assert (felt.valid, felt.contact) == (True, True)


@pytest.mark.slow
def test_a_longer_exposure_is_no_glare() -> None:
    """The camera of the raw TacTip frames lifts the dark by 24 levels in the first
    of each recording.
    """
    made = make_reconstructor(calibrated(sparse_dome(contrast_grey=170)), PROFILES["balanced"])
    lifted = step(made, sparse_dome(1, exposure_grey=24, contrast_grey=170))
    assert (lifted.valid, lifted.contact, lifted.degraded) == (True, False, None)


def test_a_stated_circle_overrules_what_is_seen() -> None:
    stated = Disc(250.0, 310.0, 170.0)
    assert calibrated(sparse_dome(), replace(SENSOR, visible_circle=stated)).geometry.disc == stated
    with pytest.raises(
        ConfigError,
        match=r"^visible_circle: found a circle at row 9000, .* overlaps the 640x480 px",
    ):
        calibrated(sparse_dome(), replace(SENSOR, visible_circle=Disc(9000.0, 310.0, 170.0)))


DARK = replace(TACTIP, surround="dark")
STATED = re.compile(r"visible_circle: \{row_px: (-?\d+), col_px: (-?\d+), radius_px: (\d+)\}")


@cache
def picture(model: SensorModel, keep: Callable[[F64], Bool] | None = None) -> U8:
    """The unloaded skin, with the features of the print that `keep` keeps by their places
    in the skin's chart.
    """
    marks = print_features(model)
    if keep is not None:
        markers, pins = keep(marks.marker_chart_mm.mean(axis=1)), keep(marks.pin_chart_mm)
        sizes = (size[pins] for size in (marks.pin_base_mm, marks.pin_tip_mm, marks.pin_length_mm))
        marks = Print(marks.marker_chart_mm[markers], marks.pin_chart_mm[pins], *sizes)
    renderer = Renderer(model, marks)
    return to_grey(renderer.expose(renderer.draw(undeformed(model.skin_radius_mm)), 0))


def cut(model: SensorModel, edges: str, part: float) -> tuple[U8, Disc]:
    """A picture whose top, bottom, left or right edge cuts off this part of the radius,
    and the true circle.
    """
    grey, reach = picture(model), (1 - part) * model.disc_radius_px
    top, left = (
        max(round(at - reach), 0) if edge in edges else 0
        for at, edge in ((model.row_c, "t"), (model.col_c, "l"))
    )
    bottom = round(model.row_c + reach) + 1 if "b" in edges else None
    right = round(model.col_c + reach) + 1 if "r" in edges else None
    return np.ascontiguousarray(grey[top:bottom, left:right]), Disc(
        model.row_c - top, model.col_c - left, model.disc_radius_px
    )


def wide(model: SensorModel) -> tuple[U8, Disc]:
    """A picture of which the disc takes 40 % of the height."""
    side = round(model.disc_radius_px / 0.4 - picture(model).shape[0] / 2)
    grey = np.pad(picture(model), side, constant_values=10)
    return grey, Disc(model.row_c + side, model.col_c + side, model.disc_radius_px)


def thresholded(model: SensorModel) -> tuple[U8, Disc]:
    """A near-binary picture, black beside the disc."""
    grey, disc = picture(model), model.geometry.disc
    side = 2 * int(disc.radius_px / 8) + 1
    white = cv2.adaptiveThreshold(
        grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, side, -8
    )
    at = np.hypot(*(np.indices(grey.shape) - np.array((disc.row_c, disc.col_c))[:, None, None]))
    return np.where(at < disc.radius_px, white, 0).astype(np.uint8), disc


def hexagon(
    rings: int, pitch_px: float, pin_px: float, *, lamps: bool = False, binary: bool = False
) -> tuple[U8, Disc]:
    """White pins without a rim, and the circle around them, half a pitch wider; `lamps`:
    a bright ring beyond.
    """
    shape, row_c, col_c = (480, 640), 236.7, 325.2
    at = np.hypot(*(np.indices(shape) - np.array((row_c, col_c))[:, None, None]))
    disc = Disc(row_c, col_c, (rings + 0.5) * pitch_px)
    steps, pins = range(-rings, rings + 1), np.zeros(shape, np.float32)
    for b, a in ((b, a) for b in steps for a in steps if abs(a + b) <= rings):
        row, col = row_c + b * pitch_px * 3**0.5 / 2, col_c + (a + b / 2) * pitch_px
        cv2.circle(
            pins, (round(16 * col), round(16 * row)), round(16 * pin_px), 1.0, -1, cv2.LINE_AA, 4
        )
    ring = (
        np.where((at > 1.25 * disc.radius_px) & (at < 1.6 * disc.radius_px), 190.0, 0.0)
        if lamps
        else 0.0
    )
    image = (
        20
        + ring
        + 150
        * cv2.GaussianBlur(pins, (0, 0), 1.2)
        * np.maximum(1 - 0.5 * (at / disc.radius_px) ** 2, 0.2)
    )
    grey = np.clip(image + np.random.default_rng(0).normal(0, 2.5, shape), 0, 255).astype(np.uint8)
    return np.where(grey > 70, np.uint8(255), np.uint8(0)) if binary else grey, disc


def error(found: Disc, true: Disc) -> float:
    """How far a circle is off, in radii."""
    beside = np.hypot(found.row_c - true.row_c, found.col_c - true.col_c)
    return float(max(beside, abs(found.radius_px - true.radius_px)) / true.radius_px)


def answer(grey: U8, true: Disc) -> tuple[str, float]:
    """What becomes of a picture, found, warned or refused, and the error of that circle (NaN:
    none).
    """
    try:
        found = visible_disc(grey, None)
    except ConfigError as refusal:
        numbers = STATED.search(str(refusal))
        return "refused", error(Disc(*map(float, numbers.groups())), true) if numbers else np.nan
    return "warned" if found_circle_doubt(grey, found) else "found", error(found, true)


@pytest.mark.parametrize(
    ("stated", "doubted"),
    [
        (Disc(118.2, 163.8, 102.5), False),
        (Disc(118.2, 163.8, 93.0), False),  # on purpose: without a poor rim
        (Disc(118.2, 163.8, 10.25), True),
        (Disc(118.2, 163.8, 75.0), True),
        (Disc(163.8, 118.2, 102.5), True),
    ],
)
def test_a_stated_circle_without_the_markers_is_doubted(stated: Disc, doubted: bool) -> None:
    for model in (HALF, TACTIP):
        assert bool(stated_circle_doubt(to_grey(references(model)[0]), stated)) == doubted


FOUND = {
    **{f"cut {edges} by 30%": partial(cut, HALF, edges, 0.3) for edges in ("t", "tl", "lr")},
    "cut tl by 20%, no ring": partial(cut, DARK, "tl", 0.2),
    "cut tblr by 5%, no ring": partial(cut, DARK, "tblr", 0.05),
    "wide margins, no ring": partial(wide, DARK),
    "near-binary": partial(thresholded, DARK),
}
BARE = {
    "19 pins": partial(hexagon, 2, 61, 16),
    "37 pins, near-binary": partial(hexagon, 3, 46, 12, binary=True),
    "61 pins in a ring": partial(hexagon, 4, 36, 9, lamps=True),
    "127 small pins": partial(hexagon, 6, 20, 1.5),
}
REFUSED = {
    "cut tblr by 20%": partial(cut, DARK, "tblr", 0.2),
    "half of the dome is printed": lambda: (
        picture(DARK, lambda at: at[:, 1] < 0),
        DARK.geometry.disc,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FOUND)
def test_a_badly_shown_circle_is_found(name: str) -> None:
    said, off = answer(*FOUND[name]())
    assert (said, off < 0.02) == ("found", True), off


@pytest.mark.slow
@pytest.mark.parametrize("name", BARE)
def test_the_circle_around_pins_that_no_rim_ends_is_found_with_a_warning(name: str) -> None:
    said, off = answer(*BARE[name]())
    assert (said, off < 0.02) == ("warned", True), off


@pytest.mark.slow
@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_suggests_a_circle(name: str) -> None:
    said, off = answer(*REFUSED[name]())
    assert (said, off < 0.1) == ("refused", True), off


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    model=st.sampled_from((HALF, DARK)),
    edges=st.sampled_from(("t", "r", "tb", "bl", "tbr", "tblr")),
    part=st.floats(0.02, 0.35),
    noise_grey=st.floats(0, 6),
    blur_px=st.floats(0.1, 2.5),
    gain=st.floats(0.2, 1.2),
)
def test_a_wrong_circle_is_never_found_silently(
    model: SensorModel, edges: str, part: float, noise_grey: float, blur_px: float, gain: float
) -> None:
    grey, true = cut(model, edges, part)
    seen = gain * cv2.GaussianBlur(grey.astype(np.float32), (0, 0), blur_px)
    seen += np.random.default_rng(1).normal(0, noise_grey, grey.shape)
    said, off = answer(np.clip(seen, 0, 255).astype(np.uint8), true)
    assert (
        said != "found" or off < 0.04
    )  # 256 of 260 within 0.02; more noise in a burnt surround: 0.09
