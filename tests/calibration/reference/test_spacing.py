from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.calibrated_sensor import HALF, TACTIP, references, sensor_of, simulated
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.reference.marker_field import MarkerField
from tacshade_edge.calibration.reference.spacing import (
    PRESSED,
    log_growth,
    widening_finding,
    widening_of,
)
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import F64, Disc, Geometry

DISC = Disc(120.0, 160.0, 100.0)
DOME = Geometry(20.0, 14.0, 50.0, DISC)
PAD = Geometry(math.inf, 30.0, 0.0, DISC, pad_radius_mm=15.0)


def lattice(pitch: float, turn_deg: float, count: int = 16) -> F64:
    """Points of a hexagonal lattice around the origin, (N, 2)."""
    i, j = np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1))
    a = math.radians(turn_deg)
    points = np.stack([(i + j / 2).ravel(), (j * math.sqrt(3) / 2).ravel()], axis=1) * pitch
    turned: F64 = points @ np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    return turned


def seen(arc_mm: F64, geometry: Geometry) -> F64:
    """Where a camera sees points of the skin, given along arcs from the middle of a dome, px (row,
    col).
    """
    far = np.hypot(arc_mm[:, 0], arc_mm[:, 1])
    along = arc_mm / np.maximum(far, 1e-12)[:, None]
    if geometry.skin == "pad":
        rho = far / geometry.visible_radius_mm
    else:
        assert geometry.camera_distance_mm
        r, c = geometry.skin_radius_mm, geometry.camera_distance_mm
        edge = math.radians(geometry.visible_half_angle_deg)
        theta = np.minimum(far / r, math.pi / 2)
        rho = np.sin(theta) / (r * np.cos(theta) + c)
        rho = rho / (math.sin(edge) / (r * math.cos(edge) + c))
    shown = rho[:, None] * along
    inside: F64 = shown[rho <= 1.05]
    return np.array((DISC.row_c, DISC.col_c)) + DISC.radius_px * inside


def field(points_px: F64) -> MarkerField:
    return MarkerField(points_px, 1.0, DISC)


def bulged(points_px: F64, row: float, col: float, factor: float, size: float) -> F64:
    """Move points away from a place (radii of the circle),
    where their spacing grows by a factor.
    """
    unit = (points_px - (DISC.row_c, DISC.col_c)) / DISC.radius_px - (row, col)
    near = np.exp(-(np.hypot(unit[:, 0], unit[:, 1]) ** 2) / size**2)
    moved: F64 = points_px + DISC.radius_px * (factor - 1) * near[:, None] * unit
    return moved


@pytest.mark.parametrize("geometry", [DOME, PAD, replace(DOME, camera_distance_mm=30.0)])
@pytest.mark.parametrize("turn_deg", [0.0, 17.0])
def test_a_free_lattice_shows_no_press(geometry: Geometry, turn_deg: float) -> None:
    found = widening_of(field(seen(lattice(2.0, turn_deg), geometry)), geometry)
    assert found is not None
    assert found.strength < PRESSED / 2


def projected(theta: float, phi: float) -> F64:
    """Where an equidistant lens sees a point of the skin of `DOME`:
    angle from the axis, in its direction.
    """
    r, c = DOME.skin_radius_mm, DOME.camera_distance_mm or 0.0
    psi = math.atan2(r * math.sin(theta), r * math.cos(theta) + c)
    seen_at: F64 = psi * np.array((math.cos(phi), math.sin(phi)))
    return seen_at


def log_size(theta: float, step: float = 1e-5) -> float:
    """The log of the side of a small square of skin as it is seen."""
    here = projected(theta, 0.0)
    down = (projected(theta + step, 0.0) - here) / step
    across = (projected(theta, step / math.sin(theta)) - here) / step
    return 0.5 * math.log(abs(down[0] * across[1] - down[1] * across[0]))


@pytest.mark.parametrize("theta_deg", [5.0, 20.0, 35.0, 50.0])
def test_the_growth_is_that_of_small_squares_of_the_dome(theta_deg: float) -> None:
    theta, edge = math.radians(theta_deg), math.radians(DOME.visible_half_angle_deg)
    rho = projected(theta, 0.0)[0] / projected(edge, 0.0)[0]
    growth = float(log_growth(DOME, np.array([rho]))[0])
    assert growth == pytest.approx(log_size(theta) - log_size(1e-3), abs=1e-3)


@pytest.mark.slow
@settings(max_examples=30)
@given(
    row=st.floats(-0.4, 0.4),
    col=st.floats(-0.4, 0.4),
    turn_deg=st.floats(0, 60),
    missing=st.integers(0, 12),
)
def test_a_press_is_found_where_it_is_although_markers_are_missing(
    row: float, col: float, turn_deg: float, missing: int
) -> None:
    points = bulged(seen(lattice(2.0, turn_deg), DOME), row, col, factor=1.3, size=0.5)
    kept = np.random.default_rng(missing).permutation(len(points))[missing:]
    found = widening_of(field(points[kept]), DOME)
    assert found is not None
    assert found.strength >= PRESSED
    place = (
        DISC.row_c + row * DISC.radius_px,
        DISC.col_c + col * DISC.radius_px,
    )
    assert math.dist((found.row_px, found.col_px), place) < 0.35 * DISC.radius_px


def test_too_few_markers_show_nothing() -> None:
    assert widening_of(field(np.full((30, 2), -1000.0)), DOME) is None


@pytest.mark.slow
@pytest.mark.parametrize("model", [HALF, TACTIP])
def test_a_plate_on_the_skin_is_seen_in_a_picture(model: SensorModel) -> None:
    plate = Press(OBJECTS["plate"](), 0.0, 0.0, 2.0)
    geometry = unloaded_geometry(model)
    assert widening_finding(to_grey(references(model)[0]), geometry) is None
    found = widening_finding(to_grey(simulated(model).frame((plate,), 5).image), geometry)
    assert found is not None
    assert sentence(found).startswith(
        "the skin seems pressed in the reference: the markers around row 1"
    )


def unloaded_geometry(model: SensorModel) -> Geometry:
    return calibrate(sensor_of(model), references(model)).calibration.geometry


@pytest.mark.slow
def test_a_dome_without_a_known_camera_is_not_refused() -> None:
    unknown = replace(sensor_of(TACTIP), camera_distance_mm=None)
    geometry = calibrate(unknown, references(TACTIP)).calibration.geometry
    assert geometry.camera_distance_mm is None
    assert widening_finding(references(TACTIP)[0][..., 0], geometry) is None
