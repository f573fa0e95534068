"""Frames that show the same untouched skin as an earlier one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import FULL, HALF, TACTIP, calibrated, simulated, unloaded
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.frame_check import first_reason
from tacshade_edge.sensor.frame_check.picture import DRIFT_LEVELS, degraded_reason
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.look import UNCHANGED_LEVELS, Eye, Look, UnchangedSkin
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Frame, Need, Reconstruction


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


@pytest.mark.parametrize("levels", [0.0, 11.9, 12.1, -12.1, 29.9, 30.1])
@pytest.mark.parametrize("cells", [0, 1, 2, 101, 102])
def test_a_common_change_is_judged_by_its_median(levels: float, cells: int) -> None:
    eye = Eye(calibrated(), PROFILES["fast"], with_network=True)
    look = Look(eye, unloaded())
    change = np.linspace(-50, 50, cells, dtype=np.float32) if cells > 1 else np.zeros(cells)
    look.__dict__["change_grey"] = change.astype(np.float32) + np.float32(levels)
    assert (look.white_reason, look.degraded) == (
        first_reason(look.white_judged),
        degraded_reason(look.white.unseen, look.drift_grey),
    )
    # It may ask for the median that is within the limit, but seldom does.
    assert not look.is_clear or abs(look.drift_grey) <= DRIFT_LEVELS
    assert look.is_clear or levels or cells == 2
