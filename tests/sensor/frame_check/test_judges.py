"""What each judge refuses, what all let pass, and figures against plain float64."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support import bad_pictures
from support.calibrated_sensor import (
    EVERY_PROFILE,
    FULL,
    HALF,
    TACTIP,
    calibrated,
    pressed,
    simulated,
    unloaded,
)
from support.examples import examples
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.reasons import code_of
from tacshade_edge.sensor.frame_check import (
    Judges,
    PictureJudge,
    first_reason,
    picture,
    plain_judges,
)
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.image.white import eighth
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Disc, Frame


def judges(model: SensorModel) -> Judges:
    return plain_judges(calibrated(model, 0))


def bad_frames(good: U8) -> dict[str, tuple[U8, str]]:
    """Frames that cannot be used, and the codes of which one must be given."""
    rows = good.shape[0]
    black, grey, white = good * 0, good * 0 + 128, good * 0 + 255
    return {
        "nearly black": (black + 5, "black"),
        "grey": (grey, "no_contrast"),
        "half white": (bad_pictures.torn(good, white, rows // 2), "saturated"),
        "torn, grey below": (bad_pictures.torn(good, grey, rows // 2), "torn surround light"),
        "torn, black from three quarters": (
            bad_pictures.torn(good, black, 3 * rows // 4),
            "torn surround",
        ),
        "noise": (camera_faults.noise(good, 30, 1), "noise"),
        "a third of the light": (camera_faults.gain(good, 0.3), "light"),
        "three times the light": (camera_faults.gain(good, 3), "light saturated"),
        "moved": (camera_faults.shift(good, 4, -3), "camera_shift"),
        "transposed": (np.ascontiguousarray(np.swapaxes(good, 0, 1)), "size"),
    }


@pytest.mark.parametrize("touched", [False, True])
@pytest.mark.parametrize("name", bad_frames(np.zeros((8, 8), np.uint8)))
def test_a_bad_frame_is_refused_for_its_reason(touched: bool, name: str) -> None:
    image, codes = bad_frames(pressed("ball", 3.0).image if touched else unloaded())[name]
    reason = judges(HALF).reason(to_grey(image))
    assert code_of(reason) in codes.split()
    assert "\n" not in str(reason)


@pytest.mark.parametrize(
    "model", [HALF, pytest.param(TACTIP, marks=pytest.mark.slow)], ids=["half", "tactip"]
)
def test_an_unloaded_frame_is_good_also_with_a_nuisance(model: SensorModel) -> None:
    good, asked = unloaded(model), judges(model)
    for image in (
        good,
        camera_faults.gain(good, 0.9),
        camera_faults.gain(good, 1.1),
        camera_faults.noise(good, 5, 1),
        camera_faults.uneven(good, model.row_c, model.col_c, model.disc_radius_px, 0.4, 130.0),
        camera_faults.shift(good, 1, 0),
        camera_faults.shift(good, 0, -1),
        camera_faults.glare(good, model.row_c, model.col_c, 15),
    ):
        assert asked.reason(to_grey(image)) is None


@pytest.mark.slow
@pytest.mark.parametrize("model", [HALF, TACTIP], ids=["half", "tactip"])
def test_no_contact_raises_a_false_alarm(model: SensorModel) -> None:
    asked, r = judges(model), model.skin_radius_mm
    for name in OBJECTS:
        for depth, place in ((1.0, 0.0), (3.0, 0.25 * r), (5.0, 0.0)):
            image = (
                simulated(model).frame((Press(OBJECTS[name](), place, 0.0, depth, 20.0),), 9).image
            )
            assert asked.reason(to_grey(image)) is None, (name, depth)


@pytest.mark.parametrize("model", [HALF, TACTIP], ids=["half", "tactip"])
def test_an_image_passes_at_once_only_if_no_judge_refuses_it(model: SensorModel) -> None:
    known, good = calibrated(model, 0), unloaded(model)
    asked = Judges(known.reference_grey, known.geometry.disc, None)
    assert asked.passes(to_grey(good))
    assert asked.passes(to_grey(pressed("ball", 2.0, model).image))
    noisy = np.random.default_rng(3).integers(0, 256, good.shape, dtype=np.uint8)
    images = [
        *(image for image, _ in bad_frames(good).values()),
        *(camera_faults.gain(good, float(part)) for part in np.linspace(0.3, 2.3, 41)),
        *(camera_faults.noise(good, sigma, 1) for sigma in range(0, 30, 2)),
        *(camera_faults.shift(good, rows, rows // 2) for rows in range(7)),
        noisy,
    ]
    for image in images:
        grey = to_grey(image)
        if grey.shape == known.reference_grey.shape:
            assert not asked.passes(grey) or asked.reason(grey) is None
    nowhere = Judges(known.reference_grey, Disc(-500.0, -500.0, 20.0), None)
    assert not nowhere.passes(to_grey(good))


@pytest.mark.parametrize("profile", EVERY_PROFILE)
def test_the_judges_see_the_same_in_every_profile(profile: str) -> None:
    made = make_reconstructor(calibrated(FULL, 0), PROFILES[profile])
    for image in (
        unloaded(FULL),
        pressed("ball", 2.0, FULL).image,
        camera_faults.shift(unloaded(FULL), 4, 5),
    ):
        found = [(each.what, each.found) for each in made.measured(image) if each.judge != "skin"]
        other = make_reconstructor(calibrated(FULL, 0), PROFILES["fast"]).measured(image)
        assert found == [(each.what, each.found) for each in other if each.judge != "skin"]
    result = made.step(Frame(0, 0, 0, camera_faults.shift(unloaded(FULL), 4, 5)))
    assert code_of(result.reason) == "camera_shift"
    assert float(result.reason.text.split()[5]) == pytest.approx(math.hypot(4, 5), abs=0.5)


@pytest.mark.parametrize(("percent", "refused"), [(24, False), (26, True)])
def test_pixels_at_the_very_level_count_as_saturated_also_in_black(
    percent: int, refused: bool
) -> None:
    mask = disc_mask(120, 120, Disc(60.0, 60.0, 50.0))
    grey = np.zeros((120, 120), np.uint8)
    grey[mask] = np.where(np.arange(np.count_nonzero(mask)) % 100 < percent, 250, 0)
    assert (
        code_of(first_reason(PictureJudge(grey * 0, mask).measured(grey))) == "saturated"
    ) == refused


def test_pictures_that_come_thresholded_are_not_saturated() -> None:
    thresholded = np.where(to_grey(unloaded(HALF)) > 90, np.uint8(255), np.uint8(0))
    disc = calibrated(HALF, 0).geometry.disc
    asked = PictureJudge(thresholded, disc_mask(*thresholded.shape, disc))
    assert first_reason(asked.measured(thresholded)) is None
    brighter = thresholded.copy()
    brighter[int(disc.row_c - 0.7 * disc.radius_px) : int(disc.row_c + 0.7 * disc.radius_px)] = 255
    assert code_of(first_reason(asked.measured(brighter))) == "saturated"


def test_a_disc_outside_the_image_is_said() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (40, 40), dtype=np.uint8)
    assert code_of(Judges(grey, Disc(500.0, 500.0, 10.0), 8.0).reason(grey)) == "no_disc"


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (9, 17), (16, 40)])
@pytest.mark.parametrize("unloaded_skin", [False, True])
def test_a_tiny_reference_passes_if_it_has_a_disc(
    size: tuple[int, int], unloaded_skin: bool
) -> None:
    grey = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    disc = Disc(size[0] / 2, size[1] / 2, max(size) / 2)
    reason = Judges(grey, disc, 8.0, unloaded=unloaded_skin).reason(grey)
    assert (reason.code.value if reason else "") == ("no_disc" if size == (1, 1) else "")


@pytest.mark.parametrize("shift", [(0, 0), (-3, 3), (5, 0), (-4, -5)])
def test_a_move_is_measured_also_in_a_contact(shift: tuple[int, int]) -> None:
    for image in (unloaded(HALF), pressed("ball", 3.0).image, pressed("plate", 5.0).image):
        moved, surround = judges(HALF).camera.measured(
            eighth(to_grey(camera_faults.shift(image, *shift)))
        )
        assert moved.found == pytest.approx(math.hypot(*shift), abs=0.4)
        assert surround.found < 0.01 or shift != (0, 0)


def test_where_nothing_lies_around_the_disc_no_camera_moves() -> None:
    calibration = calibrated(HALF, 0)
    disc = calibration.geometry.disc
    masked = np.where(disc_mask(240, 320, disc), calibration.reference_grey, np.uint8(0))
    moved = np.roll(masked, 4, axis=1)
    assert [each.found for each in Judges(masked, disc, None).camera.measured(eighth(moved))] == [
        0.0,
        0.0,
    ]


SIZES = st.tuples(st.integers(1, 90), st.integers(1, 90))


@examples(60)
@given(
    size=SIZES,
    disc=st.builds(Disc, st.floats(-9, 99), st.floats(-9, 99), st.floats(0.5, 60)),
    gain=st.floats(0.3, 2.2),
    sigma=st.floats(0, 12),
    seed=st.integers(0, 99),
)
def test_figures_are_those_of_plain_float64(
    size: tuple[int, int], disc: Disc, gain: float, sigma: float, seed: int
) -> None:
    draw = np.random.default_rng(seed).integers(0, 256, size, dtype=np.uint8)
    reference = camera_faults.gain(bad_pictures.defocus(draw, 2), 1.2)
    grey = camera_faults.noise(camera_faults.gain(reference, gain), sigma, seed)
    mask = disc_mask(*size, disc)
    found = {each.what: each for each in Judges(reference, disc, None).picture.measured(grey)}
    if not mask.any():
        assert set(found) == {"pixels of the disc"}
        return
    inside, usual = grey[mask].astype(float), reference[mask].astype(float)
    assert found["standard deviation"].found == pytest.approx(inside.std(), abs=1e-3)
    saturated, most = np.mean(inside >= 250), picture.SATURATED_PART + np.mean(usual >= 250)
    assert found["saturated part"].refuses == (saturated > most)
    first = int(np.flatnonzero(mask.any(axis=1))[0])
    steps = np.abs(np.diff(grey[first::8].astype(int), axis=1))[mask[first::8, 1:]]
    if steps.size:
        # The median by counting is the lower of two.
        assert found["pixel noise"].found == np.sort(steps)[(steps.size - 1) // 2]


@pytest.mark.parametrize("gain", [0.3, 0.44, 0.5, 1.0])
@pytest.mark.parametrize("touched", [False, True])
def test_the_light_is_that_of_the_brightest(gain: float, touched: bool) -> None:
    grey = to_grey(
        camera_faults.gain(pressed("ball", 3.0).image if touched else unloaded(HALF), gain)
    )
    least, _ = judges(HALF).light.measured(grey, eighth(grey))
    assert least.found == pytest.approx(gain, abs=0.06)
    assert least.refuses == (gain < picture.LIGHT_LOW)


def test_glare_and_a_common_change_are_measured() -> None:
    assert first_reason(picture.white_measured(0.3, -29)) is None
    assert code_of(first_reason(picture.white_measured(0.41, 0))) == "glare"
    assert code_of(first_reason(picture.white_measured(0.1, -31))) == "light_drift"
    degraded = [picture.degraded_reason(*each) for each in ((0.0, 5.0), (0.1, 5.0), (0.1, -13.0))]
    assert list(map(code_of, degraded)) == ["", "glare", "light_drift"]


def test_one_judge_at_most_refuses() -> None:
    made = judges(HALF).measured(to_grey(unloaded()) * 0)
    assert [each.judge for each in made if each.refuses] == ["picture"]
    assert {each.judge for each in made} == {"picture"}, "the others are not asked"
    assert {each.judge for each in judges(HALF).measured(to_grey(unloaded()))} == {
        "picture",
        "light",
        "camera",
        "skin",
    }


@examples(40)
@given(size=SIZES, seed=st.integers(0, 99))
def test_means_over_64_px_round_thrice(size: tuple[int, int], seed: int) -> None:
    grey = np.random.default_rng(seed).integers(0, 256, size, dtype=np.uint8)
    rows, cols = size[0] // 8, size[1] // 8
    exact = grey[: 8 * rows, : 8 * cols].astype(float).reshape(rows, 8, cols, 8).mean(axis=(1, 3))
    np.testing.assert_allclose(eighth(grey), exact, atol=1.5)
