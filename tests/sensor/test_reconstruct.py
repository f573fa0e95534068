"""Whole frames, from image to result."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from support import bad_pictures
from support.calibrated_sensor import (
    EVERY_PROFILE,
    FULL,
    HALF,
    TACTIP,
    calibrated,
    pressed,
    presses,
    reconstructor,
    references,
    sensor_of,
    step,
    unloaded,
)
from support.networks import saying
from support.soundness import assert_nothing, everything
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.contact.objects import two_means_split
from tacshade_edge.sensor.depth.learned import HEIGHT_SCALE, fold
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import KMEANS, LADDER, NETWORK, PROFILES, profile_with
from tacshade_edge.sensor.reconstruct import STAGES, Reconstructor
from tacshade_edge.types import F64, U8, Frame, Need, Reconstruction

# NumPy's arrays are seen, and OpenCV's where it returns them;
# what OpenCV frees within a call is not.
IMAGE_BYTES = FULL.image_height_px * FULL.image_width_px


def harmless(model: SensorModel) -> dict[str, U8]:
    good = unloaded(model)
    part = model.disc_radius_px / 205
    glare = {
        f"glare {r} px at {where}": camera_faults.glare(
            good, model.row_c + y * part, model.col_c + x * part, r * part
        )
        for r in (8, 14, 20)
        for where, (x, y) in {"the middle": (0, 0), "the side": (80, -50)}.items()
    }
    return glare | {
        "no contact": good,
        "dimmed": camera_faults.gain(good, 0.9),
        "brightened": camera_faults.gain(good, 1.1),
        "noise": camera_faults.noise(good, 5, 1),
        "shifted down": camera_faults.shift(good, 1, 0),
        "shifted left": camera_faults.shift(good, 0, -1),
    }


def unusable(model: SensorModel) -> dict[str, U8]:
    good = unloaded(model)
    return {
        "black": good * 0,
        "white": good * 0 + 255,
        "saturated": camera_faults.gain(good, 6),
        "noisy": camera_faults.noise(good, 30, 1),
        "torn": bad_pictures.torn(good, good * 0, model.image_height_px // 2),
        "another size": good[:-3],
    }


@pytest.mark.parametrize("profile", EVERY_PROFILE)
@pytest.mark.parametrize("model", [HALF, TACTIP], ids=["half", "tactip"])
def test_without_contact_the_height_is_exactly_zero(profile: str, model: SensorModel) -> None:
    inside = reconstructor(profile, model, 0).rays.inside
    for name, image in harmless(model).items():
        result = step(profile, image, model, 0)
        assert result.valid, (name, result.reason)
        assert not result.contact, (name, result.depth_max_mm)
        assert_nothing(result, inside)


def test_a_step_to_contact_ends_where_something_touches() -> None:
    without = {"no contact": unloaded(HALF), **unusable(HALF)}
    for name, image in without.items():
        made = reconstructor("fast", HALF, 0)
        ended = made.step(Frame(0, 0, 0, image), need=Need.CONTACT)
        assert ended is not None, name
        assert everything(ended) == everything(step("fast", image, HALF, 0)), name
    stages: list[str] = []
    touched = Frame(0, 0, 0, pressed("ball", 2.0).image)
    assert reconstructor("fast", HALF, 0).step(touched, stages.append, Need.CONTACT) is None
    assert stages == ["check", "grey", "gate"]


@pytest.mark.parametrize("profile", ["fast", "balanced", "accurate"])
def test_every_cell_of_a_contact_has_its_error_and_no_other(profile: str) -> None:
    made, touched = reconstructor(profile, HALF), Frame(0, 0, 0, pressed("ball", 2.0).image)
    result = made.step(touched)
    assert result.sigma_mm is not None
    np.testing.assert_array_equal(np.isfinite(result.sigma_mm), result.height.contact)
    assert 0.02 < np.nanmedian(result.sigma_mm) < 1.0
    nothing = made.step(Frame(1, 0, 0, unloaded(HALF)))
    assert nothing.sigma_mm is not None
    assert np.isnan(nothing.sigma_mm).all()
    stages: list[str] = []
    asked = made.step(touched, stages.append, Need.SIGMA)
    assert stages == ["check", "grey", "gate", "depth", "cloud", "sigma"]
    assert asked is not None
    np.testing.assert_array_equal(asked.sigma_mm, result.sigma_mm)
    assert asked.shear_mm is None
    unasked = made.step(touched, need=Need.SHEAR)
    assert unasked is not None
    assert unasked.sigma_mm is None


@pytest.mark.parametrize("profile", EVERY_PROFILE)
def test_an_unusable_frame_is_invalid_and_zero(profile: str) -> None:
    inside = reconstructor(profile, HALF, 0).rays.inside
    for name, image in unusable(HALF).items():
        result = step(profile, image, HALF, 0)
        assert not result.valid, name
        assert result.reason, name
        assert_nothing(result, inside)


def depth_errors(
    made: Reconstructor, model: SensorModel, presses: Iterable[tuple[str, float, float, float]]
) -> F64:
    """Relative errors of the greatest h of presses: object, depth, place."""
    errors = []
    for name, depth_mm, x_mm, y_mm in presses:
        frame = pressed(name, depth_mm, model, x_mm, y_mm)
        result = made.step(Frame(0, 0, 0, frame.image))
        assert result.degraded is None
        errors.append(result.depth_max_mm / frame.truth().depth_max_mm - 1)
    return np.array(errors)


@pytest.mark.slow
def test_pressed_depth_is_found_within_15_percent_mostly_and_without_bias() -> None:
    """One factor for the whole skin has no bias over its places,
    though it has one in the middle alone.
    """
    places = ((0.0, 0.0), (5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0))
    presses = [
        (name, mm, x, y) for name, mm, (x, y) in product(("ball", "cube"), (2.0, 3.0, 4.0), places)
    ]
    errors = depth_errors(reconstructor("fast"), HALF, presses)
    assert np.quantile(np.abs(errors), 0.8) < 0.15  # of 30 presses five miss more
    assert np.abs(errors).max() < 0.31  # 0.290
    assert abs(errors.mean()) < 0.08  # 0.073: balls alone do not show a factor this small


@pytest.mark.parametrize("profile", EVERY_PROFILE)
@pytest.mark.parametrize("name", ["ball", "cube", "large_crescent"])
def test_a_result_agrees_with_itself(profile: str, name: str) -> None:
    result = step(profile, pressed(name, 3.0).image)
    height, cloud, rays = result.height, result.cloud, reconstructor(profile).rays
    assert result.contact
    assert result.valid
    assert np.isfinite(height.height_mm[rays.inside]).all()
    assert np.isnan(height.height_mm[~rays.inside]).all()
    assert (height.height_mm[rays.inside] >= 0).all()
    assert len(cloud.points_mm) == np.count_nonzero(height.contact)
    assert set(cloud.labels.tolist()) == {o.label for o in result.objects}
    assert result.depth_max_mm == height.height_mm[height.contact].max()
    assert result.volume_mm3 > 0
    # Every point lies where its height says: at r - h from the sphere's centre.
    found = np.sort(np.linalg.norm(cloud.points_mm, axis=1))
    np.testing.assert_allclose(found, np.sort(20 - height.height_mm[height.contact]), atol=1e-3)


@pytest.mark.parametrize("profile", EVERY_PROFILE)
def test_results_alias_neither_each_other_nor_scratch(profile: str) -> None:
    frames = [pressed("ball", 3.0).image, unloaded(), pressed("cube", 2.0).image, unloaded() * 0]
    made = make_reconstructor(calibrated(), PROFILES[profile])
    results = [made.step(Frame(k, 0, 0, image)) for k, image in enumerate(frames)]
    before = [everything(r) for r in results]
    again = [made.step(Frame(k, 0, 0, image)) for k, image in enumerate(frames)]
    assert [everything(r) for r in results] == before
    assert [everything(r) for r in again] == before  # whatever came between, too
    fresh = make_reconstructor(calibrated(), PROFILES[profile])
    assert everything(fresh.step(Frame(0, 0, 0, frames[2]))) == before[2]
    for result in results:
        for array in (
            result.height.height_mm,
            result.height.contact,
            result.cloud.points_mm,
            result.cloud.labels,
        ):
            assert not array.flags.writeable


def test_a_frame_is_left_as_it_was_and_its_identity_handed_on() -> None:
    image = pressed("ball", 3.0).image.copy()
    before = image.tobytes()
    result = reconstructor("fast").step(Frame(42, 43, 44, image))
    assert image.tobytes() == before
    assert (result.seq, result.t_ns, result.wall_ns, result.profile) == (42, 43, 44, "fast")


@pytest.mark.parametrize("profile", EVERY_PROFILE)
def test_each_stage_is_marked_once_in_order(profile: str) -> None:
    marks: list[str] = []
    made = reconstructor(profile)
    made.step(Frame(0, 0, 0, pressed("ball", 3.0).image), marks.append)
    other = {"names"} if profile == "paper" else {"names", "denoise"}
    assert marks == [stage for stage in STAGES if stage not in other]
    for image, last in ((unloaded(), "gate"), (unloaded() * 0, "check")):
        marks.clear()
        made.step(Frame(0, 0, 0, image), marks.append)
        assert marks == list(STAGES[: STAGES.index(last) + 1])


@pytest.mark.slow
def test_a_sensor_that_darkens() -> None:
    assert calibrated(TACTIP).polarity == "dark"
    objects = ("ball", "cube", "cylinder", "large_crescent", "small_crescent")
    presses = product(objects, (2.0, 3.0, 4.0), (0.0,), (0.0,))
    errors = depth_errors(reconstructor("fast", TACTIP), TACTIP, presses)
    assert np.abs(errors).max() < 0.3  # 0.238
    # Not of balls alone: a factor that suits them makes all others too deep.
    assert abs(errors.mean()) < 0.1  # 0.077


@pytest.mark.parametrize("profile", EVERY_PROFILE)
def test_grey_frames_are_bgr_frames_with_equal_channels(profile: str) -> None:
    grey = np.ascontiguousarray(pressed("ball", 3.0).image[:, :, 1])
    one, three = step(profile, grey), step(profile, np.dstack([grey] * 3))
    assert one.contact
    assert everything(one) == everything(three)


@pytest.mark.slow
def test_odd_sizes_work() -> None:
    model = replace(HALF, image_height_px=241, image_width_px=319)
    assert not step("balanced", unloaded(model), model, 0).contact
    result = step("balanced", pressed("ball", 3.0, model).image, model, 0)
    assert result.contact
    grid = result.height
    assert grid.height_mm.shape == (disc_map.CELLS, disc_map.CELLS)
    reach = (disc_map.CELLS - 1) / 2 * grid.step_px  # its middle is the disc's
    assert (grid.row0 + reach, grid.col0 + reach) == pytest.approx(
        (model.row_c, model.col_c), abs=1.0
    )
    assert np.hypot(*result.objects[0].centroid_mm[:2]) < 1.5


@pytest.mark.slow
def test_what_the_image_cuts_off_the_disc_is_outside() -> None:
    model = replace(HALF, row_c=80.0)  # of 102.5 px
    result = step("balanced", pressed("ball", 3.0, model).image, model, 0)
    grid = result.height
    assert result.contact
    beyond = grid.row0 + grid.step_px * np.arange(disc_map.CELLS) < -0.5
    assert 8 < beyond.sum() < 20
    assert np.isnan(grid.height_mm[beyond]).all()
    assert np.isfinite(grid.height_mm[np.argmin(beyond)]).any()
    assert np.hypot(*result.objects[0].centroid_mm[:2]) < 1.5


@pytest.mark.slow
def test_an_orthographic_sensor_works() -> None:
    model = replace(HALF, camera_distance_mm=None)
    seen = [
        press
        for press in presses(model)
        if press.depth_mm > 1.0 and np.hypot(press.x_mm, press.y_mm) < 8
    ]
    made = make_reconstructor(
        calibrate(sensor_of(model), references(model), seen).calibration, PROFILES["balanced"]
    )
    assert not made.step(Frame(0, 0, 0, unloaded(model))).contact
    errors = depth_errors(made, model, product(("ball",), (3.0, 4.0), (0.0,), (0.0,)))
    assert np.abs(errors).max() < 0.25  # 0.240


@pytest.mark.parametrize(
    ("depth_mm", "reported_mm", "saturated"),
    [(6.0, 6.0, False), (6.4, 6.4, True), (25.0, 20.0, True)],
)
def test_what_a_network_says_beyond_its_range_is_reported(
    depth_mm: float, reported_mm: float, saturated: bool
) -> None:
    unit_mm = HALF.skin_radius_mm * np.sin(np.radians(HALF.visible_half_angle_deg)) / HEIGHT_SCALE
    row, col = np.mgrid[: disc_map.CELLS, : disc_map.CELLS] - (disc_map.CELLS - 1) / 2
    pressed_cells = np.hypot(row, col) < 20
    height = np.where(pressed_cells, depth_mm / unit_mm, -0.01).astype(np.float32)
    height[0, 0], height[60, 90] = np.nan, np.inf
    said = fold(np.stack((height, np.where(pressed_cells, np.float32(3), np.float32(-3)))), 4)
    network = saying(said)
    made = Reconstructor(replace(calibrated(HALF, 0), factors={}), PROFILES["balanced"], network)
    result = made.step(Frame(0, 0, 0, pressed("ball", 3.0).image))
    assert (result.repaired_px, result.saturated) == (2, saturated)
    assert result.depth_max_mm == pytest.approx(reported_mm, rel=1e-6)
    np.testing.assert_array_equal(result.height.contact, pressed_cells)
    assert (result.height.height_mm[made.rays.inside & ~pressed_cells] == 0).all()


def peak_bytes(made: Reconstructor, frame: Frame) -> tuple[Reconstruction, int]:
    """A step's result, and the most that it held at a time beyond what was there before."""
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    result = made.step(frame)
    return result, tracemalloc.get_traced_memory()[1] - before


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_a_frame_allocates_no_image_and_leaves_nothing_behind(profile: str) -> None:
    made = reconstructor(profile, FULL, 0)
    contact = [
        Frame(i, 0, 0, pressed("ball", depth_mm, FULL).image)
        for i, depth_mm in enumerate((1.0, 2.0))
    ]
    frames = [*contact, Frame(2, 0, 0, unloaded(FULL))]
    for frame in frames:
        made.step(frame)
    gc.collect()
    tracemalloc.start()
    try:
        for frame in frames:
            result, peak = peak_bytes(made, frame)
            assert (result.valid, result.contact) == (True, frame.seq < len(contact))
            parts = (
                result.height.height_mm,
                result.height.contact,
                result.cloud.points_mm,
                result.cloud.labels,
            )
            assert result.shear_mm is not None
            assert result.sigma_mm is not None
            parts = (*parts, result.shear_mm, result.sigma_mm)
            own = sum(part.nbytes for part in parts) if result.contact else 0
            assert (
                peak - own < (1 if profile == "fast" else 2) * IMAGE_BYTES
            )  # `accurate` prepares two pictures
        del result, parts
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(10):
            for frame in frames:
                made.step(frame)
        gc.collect()  # ONNX Runtime leaves a small cycle with each run
        assert tracemalloc.get_traced_memory()[0] - before < IMAGE_BYTES / 10
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("profile", LADDER)
def test_every_profile_can_have_the_papers_outline(profile: str) -> None:
    frame = Frame(0, 0, 0, pressed("ball", 3.0).image)
    by_network = make_reconstructor(calibrated(), profile_with(profile, NETWORK)).step(frame)
    made = make_reconstructor(calibrated(), profile_with(profile, KMEANS))
    by_heights = made.step(frame)
    height_mm = by_network.height.height_mm
    np.testing.assert_array_equal(by_heights.height.height_mm, height_mm)
    split_mm = two_means_split(height_mm[made.rays.inside])
    assert by_heights.objects
    assert (height_mm[by_heights.height.contact] > split_mm).all()
    assert np.count_nonzero(by_heights.height.contact) != np.count_nonzero(
        by_network.height.contact
    )
    for name, image in harmless(HALF).items():
        quiet = made.step(Frame(0, 0, 0, image))
        assert quiet.valid, name
        assert not quiet.contact, name


def test_paper_has_its_outline_whatever_is_asked() -> None:
    for outline in (NETWORK, KMEANS):
        assert profile_with("paper", outline) == PROFILES["paper"]
    assert profile_with("balanced", NETWORK) == PROFILES["balanced"]
    assert PROFILES["paper"].outline == KMEANS
