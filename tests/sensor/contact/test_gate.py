from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.calibrated_sensor import FULL, HALF, TACTIP, calibrated, pressed, simulated, unloaded

from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.contact.gate import (
    GATE_PART,
    UNCHANGED_LEVELS,
    ContactGate,
    UnchangedSkin,
    gate_preprocessor,
)
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Disc, Frame, Need, Reconstruction


def changed_part(image: U8, model: SensorModel = HALF, **of: Any) -> float:
    calibration = replace(calibrated(model, 0), **of)
    seen = gate_preprocessor(calibration, Preprocessor(calibration, PROFILES["accurate"]))
    return ContactGate(seen).changed_part(seen.preprocess(seen.grey(image)))


@pytest.mark.slow
@pytest.mark.parametrize("model", [HALF, FULL, TACTIP], ids=["half", "full", "tactip"])
def test_the_gate_closes_on_a_skin_at_rest_and_opens_on_a_faint_press(model: SensorModel) -> None:
    free = unloaded(model)
    assert changed_part(free, model) < 0.02
    for at_rest in (
        camera_faults.gain(free, 0.85),
        camera_faults.gain(free, 1.15),
        camera_faults.noise(free, 4, 1),
        camera_faults.uneven(free, model.row_c, model.col_c, model.disc_radius_px, 0.3, 30.0),
    ):
        assert changed_part(at_rest, model) < GATE_PART
    assert changed_part(pressed("ball", 0.3, model).image, model) > GATE_PART


@pytest.mark.parametrize("name", ["ball", "plate"])
def test_it_asks_how_much_changed_and_not_in_which_direction(name: str) -> None:
    image = pressed(name, 1.0).image
    assert (
        changed_part(image, polarity="dark")
        == changed_part(image, polarity="bright")
        > 2 * GATE_PART
    )


def test_the_gate_of_a_disc_without_cells_is_closed() -> None:
    geometry = replace(calibrated(HALF, 0).geometry, disc=Disc(500.0, 500.0, 20.0))
    assert changed_part(unloaded(), geometry=geometry) == 0.0


def fresh(profile: str, model: SensorModel = HALF) -> Reconstructor:
    """One that has seen no frame."""
    return make_reconstructor(calibrated(model), PROFILES[profile])


def stepped(made: Reconstructor, frame: Frame, **step: Any) -> tuple[Reconstruction | None, bool]:
    """The result, and whether the frame was recognised: only then is it valid after the check."""
    marks: list[str] = []
    result = made.step(frame, marks.append, **step)
    return result, marks == ["check"] and result is not None and result.valid


def said(result: Reconstruction | None) -> object:
    return (
        None if result is None else (result.valid, result.reason, result.degraded, result.contact)
    )


def each_by_itself(images: list[U8], **step: Any) -> list[object]:
    """By a reconstructor that remembers no frame before it."""
    return [
        said(fresh("balanced").step(Frame(k, k, k, image), **step))
        for k, image in enumerate(images)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("model", [HALF, FULL, TACTIP], ids=["half", "full", "tactip"])
def test_frames_of_a_free_skin_are_judged_once(model: SensorModel) -> None:
    made = fresh("balanced", model)
    for k in range(6):
        image = unloaded(model, noise_seed=300 + k)
        result, recognised = stepped(made, Frame(k, 7 * k, 9 * k, image))
        assert recognised is (k > 0)
        assert result is not None
        assert result.valid
        assert not result.contact
        assert (result.seq, result.t_ns, result.wall_ns) == (k, 7 * k, 9 * k)
        assert np.nansum(np.abs(result.height.height_mm)) == 0


@pytest.mark.slow
def test_a_press_that_creeps_in_is_felt_as_early() -> None:
    depths_mm = (*np.arange(0.0, 0.08, 0.004), *np.arange(0.08, 0.5, 0.02))
    images = [
        simulated(HALF).frame((Press(ball(8.0), 0.0, 0.0, d),) if d else (), 100).image
        for d in depths_mm
    ]
    made, known, found = fresh("balanced"), 0, list[object]()
    for k, image in enumerate(images):
        result, recognised = stepped(made, Frame(k, k, k, image), need=Need.CONTACT)
        known += recognised
        found.append(said(result))
    assert found == each_by_itself(images, need=Need.CONTACT)
    assert found[-1] is None, "the deepest is felt"
    assert known >= 3


def test_what_was_degraded_stays_degraded() -> None:
    image = unloaded().copy()
    rows, cols = (size // 2 for size in image.shape[:2])
    image[rows : rows + 25, cols : cols + 25] = 255  # glare
    made = fresh("balanced")
    first, second = (made.step(Frame(k, k, k, image)) for k in range(2))
    assert first.valid
    assert first.degraded
    assert second.degraded == first.degraded
    assert made.step(Frame(2, 2, 2, unloaded())).degraded is None


def test_a_frame_of_another_size_or_black_is_not_taken_for_it() -> None:
    made = fresh("balanced")
    image = unloaded()
    assert made.step(Frame(0, 0, 0, image)).valid
    assert not made.step(Frame(1, 1, 1, image[:-2])).valid
    assert not made.step(Frame(2, 2, 2, np.zeros_like(image))).valid
    assert made.step(Frame(3, 3, 3, image)).valid


@pytest.mark.parametrize(
    ("levels", "shown"), [(UNCHANGED_LEVELS, True), (UNCHANGED_LEVELS + 1, False)]
)
@pytest.mark.parametrize("halved", [True, False])
def test_one_pixel_decides(levels: float, shown: bool, halved: bool) -> None:
    calibration = calibrated()
    grey = calibration.reference_grey.copy()
    memory = UnchangedSkin(grey.shape, calibration.geometry.disc, halved=halved)
    assert not memory.shown_in(grey), "no frame was judged"
    disc = calibration.geometry.disc
    row, col = round(disc.row_c) // 2 * 2, round(disc.col_c) // 2 * 2
    grey[row : row + 2, col : col + 2] = 100
    memory.keep(grey, None)
    grey[row : row + (1 if halved else 2), col : col + (1 if halved else 2)] = 100 + levels
    assert memory.shown_in(grey) is shown
