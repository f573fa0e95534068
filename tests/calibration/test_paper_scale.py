"""The paper's α from presses: deeper presses get deeper,
and a calibration without presses keeps its constant.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, pressed, presses, step
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.paper_scale import with_paper_scale
from tacshade_edge.sensor.depth.hybrid_sfs import change_grey
from tacshade_edge.sensor.image.preprocess import GreyMaps

DEPTHS_MM = (1.0, 2.0, 3.0, 4.0)


def found_mm(name: str, count: int) -> list[float]:
    return [step("paper", pressed(name, mm).image, HALF, count).depth_max_mm for mm in DEPTHS_MM]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "cylinder"])
def test_a_deeper_press_is_deeper(name: str) -> None:
    found = found_mm(name, 20)
    assert found == sorted(found)
    off = np.abs(np.subtract(found, DEPTHS_MM)).mean()
    constant = np.abs(np.subtract(np.mean([p.depth_mm for p in presses()]), DEPTHS_MM)).mean()
    print(
        f"figure: depth of a {name} with α of presses: off by {off:.2f} mm, constant {constant:.2f}"
    )
    assert off < 0.7 * constant


@pytest.mark.slow
def test_without_presses_the_depth_is_a_constant() -> None:
    calibration = calibrated(HALF, 0)
    assert (calibration.alpha, calibration.alpha_grey) == (15.0, 0.0)
    assert found_mm("ball", 0) == pytest.approx([15 * calibration.geometry.mm_per_px] * 4, rel=1e-6)


@pytest.mark.slow
def test_alpha_is_the_mean_depth_at_the_change_that_belongs_to_it() -> None:
    table = presses()[:6]
    made = with_paper_scale(calibrated(HALF, 0), table)
    mean_mm = np.mean([press.depth_mm for press in table])
    assert made.alpha * made.geometry.mm_per_px == pytest.approx(mean_mm)
    assert 1 < made.alpha_grey < 60
    twice = [replace(press, depth_mm=2 * press.depth_mm) for press in table]
    deeper = with_paper_scale(calibrated(HALF, 0), twice)
    assert (deeper.alpha, deeper.alpha_grey) == pytest.approx((2 * made.alpha, made.alpha_grey))


def test_presses_that_change_nothing_leave_a_constant() -> None:
    calibration = calibrated(HALF, 0)
    still = replace(presses()[0], image=np.asarray(calibration.reference_grey))
    black = replace(still, image=np.zeros_like(still.image))
    for press in (still, black):
        made = with_paper_scale(calibration, [press])
        assert 0 <= made.alpha_grey <= 255


def test_the_change_is_the_rms_over_the_disc() -> None:
    g_d = np.array([[3.0, -4.0], [np.nan, 1e9]], np.float32)
    inside = np.array([[True, True], [True, False]])
    maps = GreyMaps(g=g_d, g0=g_d, g_d=g_d, inside=inside)
    assert change_grey(maps) == pytest.approx(np.sqrt(25 / 3))
    assert change_grey(replace(maps, inside=np.zeros((2, 2), bool))) == 0


def test_an_older_file_has_a_constant(tmp_path: object) -> None:
    """A calibration without the key is one with α for every change, and keeps its checksum."""
    calibration = calibrated(HALF, 0)
    path = tmp_path / "cal.npz"  # type: ignore[operator]
    calibration_file.save(path, calibration)
    assert b"alpha_grey" not in path.read_bytes()
    assert calibration_file.load(path).alpha_grey == 0
    calibration_file.save(path, replace(calibration, alpha_grey=7.5))
    assert calibration_file.load(path).alpha_grey == 7.5
