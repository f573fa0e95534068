from __future__ import annotations

import re
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from support.calibrated_sensor import (
    FULL,
    HALF,
    TACTIP,
    calibrated,
    pressed,
    random_sensor,
    simulated,
    unloaded,
)
from support.examples import examples
from support.plain_blocks import plain_blocks

from tacshade_edge.core.frame_check import blocks, torn, validity
from tacshade_edge.core.frame_check.validity import FrameCheck, frame_check, invalid_reason, sensor_check
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.reasons import text_of
from tacshade_edge.simulator import camera_faults
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.studies.evaluate.work import scenes
from tacshade_edge.types import U8, Bool, Disc


def check_of(model: SensorModel) -> FrameCheck:
    calibration = calibrated(model, 0)
    mask = disc_mask(calibration.image_height_px, calibration.image_width_px, calibration.geometry.disc)
    return frame_check(calibration.reference_grey, mask, calibration.geometry.disc)


def bad_frames(good: U8) -> dict[str, tuple[U8, str]]:
    """Frames that cannot be used, and what must be said of them."""
    rows = good.shape[0]
    black, grey, white = good * 0, good * 0 + 128, good * 0 + 255
    return {
        "black": (black, "black"),
        "nearly black": (black + 5, "black"),
        "grey": (grey, "no contrast"),
        "white": (white, "saturated"),
        "half white": (camera_faults.torn(good, white, rows // 2), "saturated"),
        "torn, black below": (camera_faults.torn(good, black, rows // 2), "torn"),
        "torn, grey below": (camera_faults.torn(good, grey, rows // 2), "torn"),
        "torn, black from three quarters": (camera_faults.torn(good, black, 3 * rows // 4), "torn"),
        "line sync lost": (camera_faults.torn(good, good, rows // 2, 40), "torn"),
        "noise": (camera_faults.noise(good, 30, 1), "noise"),
        "a third of the light": (camera_faults.gain(good, 0.3), "light"),
        "three times the light": (camera_faults.gain(good, 3), "light|saturated"),
        "half the size": (good[::2, ::2], "size"),
        "transposed": (np.ascontiguousarray(np.swapaxes(good, 0, 1)), "size"),
    }


@pytest.mark.parametrize("model", [HALF, FULL], ids=["half", "full"])
@pytest.mark.parametrize("touched", [False, True])
@pytest.mark.parametrize("name", bad_frames(np.zeros((8, 8), np.uint8)))
def test_a_bad_frame_is_told_why(model: SensorModel, touched: bool, name: str) -> None:
    good = pressed("ball", 3.0, model).image if touched else unloaded(model)
    image, said = bad_frames(good)[name]
    reason = text_of(invalid_reason(to_grey(image), check_of(model)))
    assert any(reason.startswith(word) for word in said.split("|")), reason
    assert "\n" not in reason
    assert "nan" not in reason


@pytest.mark.parametrize(
    "model", [HALF, TACTIP, random_sensor(0), random_sensor(1)], ids=["half", "tactip", "r0", "r1"]
)
def test_an_unloaded_frame_is_good_also_with_a_nuisance(model: SensorModel) -> None:
    good, check = unloaded(model), check_of(model)
    for image in (
        good,
        camera_faults.gain(good, 0.9),
        camera_faults.gain(good, 1.1),
        camera_faults.noise(good, 5, 1),
        camera_faults.shift(good, 1, 0),
        camera_faults.shift(good, 0, -1),
        camera_faults.glare(good, model.row_c, model.col_c, 15),
    ):
        assert invalid_reason(to_grey(image), check) is None


def false_alarms(model: SensorModel, names: list[str], depths: tuple[float, ...]) -> list[str]:
    check, r = check_of(model), model.skin_radius_mm
    alarms = []
    for name in names:
        for depth in depths:
            for place in (0.0, 0.25 * r):
                image = simulated(model).frame((Press(OBJECTS[name](), place, 0.0, depth, 20.0),), 9).image
                if reason := invalid_reason(to_grey(image), check):
                    alarms.append(f"{name} {depth} mm at {place:.1f}: {reason}")
    return alarms


@pytest.mark.slow
def test_no_contact_raises_a_false_alarm() -> None:
    assert false_alarms(HALF, sorted(OBJECTS), (3.0,)) == []


@pytest.mark.slow
@pytest.mark.parametrize("model", [TACTIP, *map(random_sensor, range(2))])
def test_no_contact_raises_a_false_alarm_on_other_sensors(model: SensorModel) -> None:
    assert false_alarms(model, sorted(OBJECTS), (1.0, 5.0)) == []


@pytest.mark.parametrize(("percent", "said"), [(24, False), (26, True)])
def test_pixels_at_the_very_level_count_as_saturated_also_in_black(percent: int, said: bool) -> None:
    disc = Disc(60.0, 60.0, 50.0)
    mask = disc_mask(120, 120, disc)
    grey = np.zeros((120, 120), np.uint8)
    grey[mask] = np.where(np.arange(np.count_nonzero(mask)) % 100 < percent, 250, 0)
    assert text_of(invalid_reason(grey, frame_check(grey * 0, mask, disc))).startswith("saturated") == said


def test_pictures_that_come_thresholded_are_not_saturated() -> None:
    good = unloaded(HALF)
    thresholded = np.where(to_grey(good) > 90, np.uint8(255), np.uint8(0))
    disc = calibrated(HALF, 0).geometry.disc
    check = frame_check(thresholded, disc_mask(*thresholded.shape, disc), disc)
    assert invalid_reason(thresholded, check) is None
    brighter = thresholded.copy()
    brighter[int(disc.row_c - 0.7 * disc.radius_px) : int(disc.row_c + 0.7 * disc.radius_px)] = 255
    assert text_of(invalid_reason(brighter, check)).startswith("saturated")


def test_a_disc_outside_the_image_is_said() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (40, 40), dtype=np.uint8)
    disc = Disc(500.0, 500.0, 10.0)
    assert text_of(invalid_reason(grey, frame_check(grey, disc_mask(40, 40, disc), disc))).startswith("disc")


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (7, 9), (8, 8), (9, 17)])
def test_tiny_images_have_an_answer(size: tuple[int, int]) -> None:
    grey = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    disc = Disc(size[0] / 2, size[1] / 2, max(size) / 2)
    invalid_reason(grey, frame_check(grey, disc_mask(*size, disc), disc))


@pytest.mark.slow
@pytest.mark.parametrize("shift_px", [5, 10, 20])
@pytest.mark.parametrize("row", [150, 240, 330])
def test_a_small_tear_is_seen_where_two_frames_meet(row: int, shift_px: int) -> None:
    torn = camera_faults.torn(unloaded(FULL), unloaded(FULL, noise_seed=51), row, shift_px)
    assert re.match(
        rf"torn: row {row - 1} |torn or moved",
        text_of(invalid_reason(to_grey(torn), sensor_check(calibrated(FULL), unloaded=True))),
    )


def plain_spikes(grey: U8, mask: Bool) -> dict[int, float]:
    """Row to how much it differs from the next beside its neighbours, where the bands of columns agree."""
    step = np.abs(np.diff(grey.astype(np.float64), axis=0)) * mask[:-1]
    long = np.flatnonzero(mask[:-1].sum(axis=1) >= torn.ROW_PX)
    if long.size < 8:
        return {}
    columns = np.flatnonzero(mask.any(axis=0))
    edges = np.linspace(columns[0], columns[-1] + 1, torn.BANDS + 1).astype(int).tolist()
    bands = [(0, mask.shape[1]), *pairwise(edges)]
    means = [step[:, a:b].sum(axis=1) / np.maximum(mask[:-1, a:b].sum(axis=1), 1) for a, b in bands]
    medians = [np.median(mean[long]) + 1 for mean in means]
    spikes = {}
    for row in long[2:-2].tolist():
        beside = (row - 2, row - 1, row + 1, row + 2)
        total, *each = (
            (mean[row] - sum(mean[k] for k in beside) / 4) / median for mean, median in zip(means, medians, strict=True)
        )
        if sum(one > torn.BAND_SPIKE for one in each) >= torn.BANDS - 1:
            spikes[row] = float(total)
    return spikes


def plain_reason(grey: U8, reference: U8, mask: Bool, disc: Disc) -> tuple[str, float]:
    """What is wrong with a frame, and the figure said of it: the check in plain float64, whatever it costs."""
    if not mask.any():
        return "disc", 0
    inside = grey[mask].astype(np.float64)
    bright, usual = (np.mean(i[mask] >= validity.SATURATED_LEVEL) for i in (grey, reference))
    if bright > validity.SATURATED_PART + usual:
        return "saturated", 100 * bright
    if inside.std() < min(validity.FLAT_STD, validity.FLAT_OVER_REFERENCE * reference[mask].std()):
        return "black" if inside.mean() < validity.BLACK_LEVEL else "no contrast", inside.mean()
    steps, usual_steps = (np.abs(np.diff(i[::8].astype(int), axis=1))[mask[::8, 1:]] for i in (grey, reference))
    if steps.size:
        most = max(validity.NOISE_STEP, np.median(usual_steps) + validity.NOISE_OVER_REFERENCE)
        if np.median(steps) > most:
            return "noise", float(np.median(steps))
    (level, contrast), (usual, usual_contrast) = plain_blocks(grey), plain_blocks(reference)
    rows, cols = (8 * np.arange(n) + 3.5 for n in level.shape)
    r = np.hypot(rows[:, None] - disc.row_c, cols[None, :] - disc.col_c)
    within = r < disc.radius_px - 8 * 0.7072
    if not within.any():
        return "", 0
    textured = within & (usual_contrast >= blocks.TEXTURED_STD)
    total, lost = textured.sum(axis=1), (textured & (contrast < blocks.LOST_STD)).sum(axis=1)
    enough = np.maximum(blocks.ROW_BLOCKS, within.sum(axis=1) / 2)
    empty = np.count_nonzero((total >= enough) & (lost > blocks.LOST_PART * total))
    if empty >= blocks.LOST_ROWS:
        return "torn", 8 * float(empty)
    usual_spikes = plain_spikes(reference, mask)
    over = {row: spike - max(usual_spikes.get(row, 0), 0) for row, spike in plain_spikes(grey, mask).items()}
    row = max(over, key=lambda row: over[row], default=-1)
    if row >= 0 and over[row] > torn.SPIKE:
        return "torn", float(row)
    if not textured.any():
        return "", 0
    sampled = mask[::4, ::4]
    at_rest = reference[::4, ::4][sampled]
    split = cv2.threshold(at_rest, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]
    shown = 100 * (1 - min(np.mean(at_rest > split) / 2, validity.BRIGHT_PART))
    gain = np.percentile(grey[::4, ::4][sampled], shown) / max(np.percentile(at_rest, shown), 1)
    common = np.median(level[textured]) / max(np.median(usual[textured]), 1)
    if gain < blocks.LIGHT_LOW or common > blocks.LIGHT_HIGH:
        return "light", float(gain if gain < blocks.LIGHT_LOW else common)
    surround = (r > blocks.SURROUND_FROM * disc.radius_px + 8 * 0.7072) & (r < 1.35 * disc.radius_px)
    if not surround.any():
        return "", 0
    lit = surround & (usual >= blocks.LIT_LEVEL)
    light = np.clip(
        np.median((level / np.maximum(usual, 1))[lit]) if lit.any() else 1, blocks.LIGHT_LOW, blocks.LIGHT_HIGH
    )
    expected = np.minimum(usual * light, 255)
    moved = (np.abs(level - expected) > blocks.SURROUND_LEVELS + 0.25 * expected)[surround].mean()
    return ("torn or moved", 100 * float(moved)) if moved > blocks.SURROUND_PART else ("", 0)


def assert_says(reason: str, kind: str, figure: float) -> None:
    assert reason.partition(":")[0] == kind, (reason, figure)
    if kind not in ("", "disc"):
        said = re.search(r"\d+(\.\d+)?", reason)
        assert said
        assert abs(float(said[0]) - figure) < (0.0051 if kind == "light" else 0.51), (reason, figure)


ROWS, COLS = st.integers(0, 239), st.integers(-9, 9)
DISTURBED = st.lists(
    st.one_of(
        st.builds(lambda factor: lambda image: camera_faults.gain(image, factor), st.floats(0.3, 2.4)),
        st.builds(lambda sigma, seed: lambda image: camera_faults.noise(image, sigma, seed), st.floats(0, 20), ROWS),
        st.builds(lambda rows, cols: lambda image: camera_faults.shift(image, rows, cols), COLS, COLS),
        st.builds(lambda row, cols: lambda image: camera_faults.torn(image, image, row, cols), ROWS, COLS),
        st.builds(lambda row, level: lambda image: camera_faults.torn(image, image * 0 + level, row), ROWS, ROWS),
        st.builds(lambda sigma: lambda image: camera_faults.defocus(image, sigma), st.floats(0.5, 20)),
        st.builds(lambda row, col: lambda image: camera_faults.glare(image, row, col, 60, 250), ROWS, ROWS),
        st.builds(lambda part: lambda image: camera_faults.gain(image, part) + np.uint8(9), st.floats(0, 0.2)),
    ),
    max_size=2,
)
PLACES = st.sampled_from(
    [
        (slice(None), slice(None)),
        (slice(50, None), slice(None)),
        (slice(None, 203), slice(3, 200)),
        (slice(63, 180), slice(None)),
    ]
)


@pytest.mark.slow
@examples(60)
@given(touched=st.booleans(), changes=DISTURBED, place=PLACES)
def test_the_fast_check_says_what_the_plain_one_says(touched: bool, changes: list, place: tuple[slice, slice]) -> None:
    """Of whole images, and of parts whose border cuts the disc."""
    image = pressed("ball", 4.0, HALF).image if touched else unloaded(HALF)
    for change in changes:
        image = change(image)
    calibration = calibrated(HALF, 0)
    whole = calibration.geometry.disc
    disc = Disc(whole.row_c - (place[0].start or 0), whole.col_c - (place[1].start or 0), whole.radius_px)
    grey, reference = to_grey(image)[place], calibration.reference_grey[place]
    mask = disc_mask(*grey.shape, disc)
    reason = text_of(invalid_reason(grey, frame_check(reference, mask, disc, unloaded=True)))
    assert_says(reason, *plain_reason(grey, reference, mask, disc))


@given(
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    disc=st.builds(Disc, st.floats(-9, 49), st.floats(-9, 49), st.floats(0.5, 40)),
    gain=st.floats(0.3, 2.2),
    sigma=st.floats(0, 12),
    seed=st.integers(0, 99),
)
@example(size=(3, 18), disc=Disc(1, 9.5, 1), gain=0.375, sigma=1, seed=30)  # a deviation of 3.0 but for a rounding
def test_the_same_of_tiny_images(size: tuple[int, int], disc: Disc, gain: float, sigma: float, seed: int) -> None:
    draw = np.random.default_rng(seed).integers(0, 256, size, dtype=np.uint8)
    reference = camera_faults.gain(camera_faults.defocus(draw, 2), 1.2)
    grey = camera_faults.noise(camera_faults.gain(reference, gain), sigma, seed)
    mask = disc_mask(*size, disc)
    check = frame_check(reference, mask, disc, unloaded=True)
    assume(not mask.any() or abs(grey[mask].std() - check.flat_std) > 1e-6)
    assert_says(text_of(invalid_reason(grey, check)), *plain_reason(grey, reference, mask, disc))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "name"), [(122, "large_crescent"), (119, "small_crescent")])
def test_a_deep_wide_contact_on_a_dim_sensor_is_not_torn(seed: int, name: str) -> None:
    """It was: the markers of short rows all hidden."""
    sensor = SimulatedSensor(random_model(seed))
    mean = np.mean([to_grey(sensor.frame((), k).image) for k in range(3)], axis=0).astype(np.uint8)
    disc = sensor.model.geometry.disc
    check = frame_check(mean, disc_mask(*mean.shape, disc), disc)
    for scene in scenes(sensor.model, seed, name, (4.5, 6.0)):
        image = to_grey(sensor.frame((scene.press,), scene.noise_seed).image)
        assert "torn" not in text_of(invalid_reason(image, check))
