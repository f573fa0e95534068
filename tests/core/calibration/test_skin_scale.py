"""A sensor that is scaled as a whole shows the same images: all that is decided must be the same."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
from support.calibrated_sensor import HALF, presses, references, sensor_of
from support.observed_presses import SEEDS, observed

from tacshade_edge.core.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation import PressObservation
from tacshade_edge.core.calibration.presses.press_selection import agreement_mae_mm, outliers
from tacshade_edge.core.calibration.presses.table_check import table_hints
from tacshade_edge.core.calibration.quality import missing_coverage
from tacshade_edge.core.geometry.disc_map import skin_scale
from tacshade_edge.inference.network import load_networks
from tacshade_edge.types import Disc, Geometry

RADII_MM = (12.0, 30.0)


def without_numbers(lines: Sequence[str]) -> list[str]:
    return [re.sub(r"-?\d+(\.\d+)?", "#", line) for line in lines]


def test_the_scale() -> None:
    assert skin_scale(Geometry(30.0, None, 50.0, Disc(0, 0, 1))) == pytest.approx(1.5)


def scaled(press: PressObservation, by: float) -> PressObservation:
    return replace(
        press,
        bright_mm2=by * by * press.bright_mm2,
        located_x_mm=by * press.located_x_mm,
        located_y_mm=by * press.located_y_mm,
        radius_mm=by * press.radius_mm,
        depth_mm=by * press.depth_mm,
        x_mm=None if press.x_mm is None else by * press.x_mm,
        y_mm=None if press.y_mm is None else by * press.y_mm,
    )


def decisions(observations: Sequence[PressObservation], geometry: Geometry) -> tuple[object, ...]:
    return (
        list(outliers(observations, geometry)),
        without_numbers(table_hints(observations, geometry)),
        without_numbers(missing_coverage(observations, geometry)),
        pytest.approx(agreement_mae_mm(observations, geometry) / geometry.skin_radius_mm, rel=1e-6),
    )


TABLES = {
    "true": lambda o, k, s: o,
    "places off by about what is allowed": lambda o, k, s: replace(o, x_mm=o.x_mm + s * 0.25 * k),
    "depths off by about what is allowed": lambda o, k, s: replace(o, depth_mm=o.depth_mm * (1 + 0.1 * (k % 7))),
    "depths in cm": lambda o, k, s: replace(o, depth_mm=o.depth_mm / 10),
    "depths of a fifth": lambda o, k, s: replace(o, depth_mm=o.depth_mm / 5),
    "small depths": lambda o, k, s: replace(o, depth_mm=o.depth_mm / 2),
    "axes swapped": lambda o, k, s: replace(o, x_mm=o.y_mm, y_mm=o.x_mm),
    "axes swapped near the middle": lambda o, k, s: replace(o, x_mm=0.3 * o.y_mm, y_mm=0.3 * o.x_mm),
    "one side": lambda o, k, s: replace(o, x_mm=abs(o.x_mm)),
}


@pytest.mark.slow
@pytest.mark.parametrize("radius_mm", RADII_MM)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("table", TABLES)
def test_the_presses_are_judged_alike(table: str, seed: int, radius_mm: float) -> None:
    presses, geometry = observed(seed)
    changed = [TABLES[table](o, k, skin_scale(geometry)) for k, o in enumerate(presses)]  # type: ignore[no-untyped-call]
    by = radius_mm / geometry.skin_radius_mm
    there = replace(geometry, skin_radius_mm=radius_mm)
    assert decisions([scaled(o, by) for o in changed], there) == decisions(changed, geometry)


@cache
def calibrated_at(radius_mm: float, off_mm: float) -> CalibrationResult:
    """The sensor `HALF` as if it had another radius; depths too great, one depth and one place wrong."""
    by = radius_mm / HALF.skin_radius_mm
    stated = sensor_of(replace(HALF, skin_radius_mm=radius_mm, camera_distance_mm=by * (HALF.camera_distance_mm or 0)))

    def press(k: int, p: KnownPress) -> KnownPress:
        return replace(
            p,
            radius_mm=by * p.radius_mm,
            depth_mm=by * (p.depth_mm + off_mm + 2.5 * (k == 6)),
            x_mm=by * ((p.x_mm or 0.0) + 4.5 * (k == 9)),
            y_mm=by * (p.y_mm or 0.0),
        )

    table = [press(k, p) for k, p in enumerate(presses())]
    return calibrate(stated, references(), table, networks={"accurate": load_networks()["accurate"]})


@pytest.mark.slow
@pytest.mark.parametrize("off_mm", [0.0, 1.0])
@pytest.mark.parametrize("radius_mm", RADII_MM)
def test_a_calibration_is_the_same(radius_mm: float, off_mm: float) -> None:
    nominal, there = calibrated_at(HALF.skin_radius_mm, off_mm), calibrated_at(radius_mm, off_mm)
    assert without_numbers(there.warnings) == without_numbers(nominal.warnings)
    assert any("fit better if all are" in warning for warning in there.warnings) == bool(off_mm)
    assert there.quality.grade == nominal.quality.grade
    assert without_numbers(there.quality.advice) == without_numbers(nominal.quality.advice)
    assert there.calibration.factors == pytest.approx(nominal.calibration.factors, rel=1e-4)
    by = radius_mm / HALF.skin_radius_mm
    fit, expected = there.calibration.fit, nominal.calibration.fit
    assert fit is not None
    assert expected is not None
    assert fit.presses == expected.presses
    assert fit.agreement_mae_mm == pytest.approx(by * expected.agreement_mae_mm, rel=1e-4)
    assert fit.profiles["accurate"].depth_worst_mm == pytest.approx(
        by * expected.profiles["accurate"].depth_worst_mm, rel=1e-3
    )
