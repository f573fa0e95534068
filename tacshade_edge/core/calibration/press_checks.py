"""Do the presses agree with what is stated of them, and do they cover what a calibration must cover?

The judge is a fit of its own, sharper than a reconstruction because here the ball and its place are known: the travel
from first touch is a power law of what the image shows. (The depth of a press is that travel and how far the ball's
lowest point lay from the skin at first touch.) Its figures are those of docs/calibration.md, "What it checks".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.screened_change import REACH_RADII, brightening, gathered_change
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.image.grey_maps import GreyMaps
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.types import F64, Geometry

# log(travel) on 1, log χ, ρ², ρ⁴, log ball radius, log brightened area, log brightening: the mean weights of 29
# simulated sensors, towards which the fit is pulled (lengths scaled to a skin of 20 mm).
_PRIOR = np.array([0.0, 1.2, 0.0, 0.0, -0.3, 0.2, -0.25])
_PULL = 0.01
# χ alone tells the travel of any sensor of the family within a factor of 2: enough for a wrong unit.
_ANY_SENSOR = -1.61, 1.3
_UNIT_FACTOR = 4.0
_UNITS = {"cm": 10.0, "inches": 25.4, "m": 1000.0}
# A press disagrees beyond so many spreads; the spread is at least this part of the travel and these mm.
_SPREADS, _LEAST_SPREAD, _FLOOR_MM = 4.0, 0.06, 0.1
# ... or when its place is further off than so many times the median press, with bounds (good presses reach 2.9 mm).
_PLACE_MM, _PLACE_MOST_MM, _PLACE_MEDIANS = 3.5, 5.0, 3.0
# Another reading of the table is hinted at when it leaves less than this part of the error.
_TRAVEL_PART, _OFFSET_PART, _PLACE_PART = 0.9, 0.72, 0.5
_LEAST_OFFSET_MM, _ERROR_CAP_MM = 0.4, 1.0
# Presses cover a sensor when they span this much: of the disc (its radius), of depth and of ball radius (ratios).
_SPREAD_RHO, _DEPTH_RATIO, _RADIUS_RATIO = 0.35, 2.0, 1.5
_FEW = 16
_ROUNDS = 12


@dataclass(frozen=True, slots=True)
class Evidence:
    """One press: what its image shows, and what is stated of it.

    Attributes
    ----------
    name : str
    chi_grey, peak_grey : float
        Greatest gathered change, greatest brightening; grey levels, above 0.
    area_mm2 : float
        Skin that brightens by half of the peak or more.
    found_x_mm, found_y_mm : float
        Where it brightens most.
    radius_mm, depth_mm : float
    x_mm, y_mm : float or None
        As stated.
    """

    name: str
    chi_grey: float
    peak_grey: float
    area_mm2: float
    found_x_mm: float
    found_y_mm: float
    radius_mm: float
    depth_mm: float
    x_mm: float | None
    y_mm: float | None

    @property
    def place_mm(self) -> tuple[float, float]:
        """The stated place, or the found one."""
        if self.x_mm is None or self.y_mm is None:
            return self.found_x_mm, self.found_y_mm
        return self.x_mm, self.y_mm


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A press that does not fit what is stated of it: its index, and why."""

    index: int
    reason: str


def gather_evidence(
    front: Preprocessor,
    name: str,
    maps: GreyMaps,
    stated: tuple[float, float, float | None, float | None],
) -> Evidence:
    """Read one press.

    Parameters
    ----------
    front : Preprocessor
    name : str
    maps : GreyMaps
        Of its image.
    stated : radius_mm, depth_mm, x_mm, y_mm
    """
    geometry = front.calibration.geometry
    reach = REACH_RADII * geometry.skin_radius_mm / (front.profile.stride_px * geometry.mm_per_px)
    chi = gathered_change(maps, reach)
    bright = brightening(maps, reach)
    peak = np.unravel_index(int(np.argmax(bright)), bright.shape)
    height = np.full(chi.shape, stated[1], dtype=np.float32)
    place = skin_points(height, front.rays, geometry)[peak]
    return Evidence(
        name,
        max(float(chi.max()), 1e-3),
        max(float(bright.max()), 0.1),
        max(float(np.count_nonzero(bright > 0.5 * bright.max())), 1.0) * front.cell_mm2,
        float(place[0]),
        float(place[1]),
        *stated,
    )


def position_mae_mm(rows: Sequence[Evidence]) -> float:
    """How far from the stated places the skin brightens most, on average; 0 where none is stated."""
    off = [
        math.hypot(row.found_x_mm - row.x_mm, row.found_y_mm - row.y_mm)
        for row in rows
        if row.x_mm is not None and row.y_mm is not None
    ]
    return float(np.mean(off)) if off else 0.0


def disagreements(rows: Sequence[Evidence], geometry: Geometry) -> tuple[Disagreement, ...]:
    """Presses whose place, or whose depth predicted from all the others, is far from what is stated."""
    found = _misplaced(rows, geometry)
    while True:
        # Without the worst, what is left may show more: many wrong presses widen the spread that hides them.
        judged = [k for k in range(len(rows)) if k not in found]
        if len(judged) < 3:
            break
        some = [rows[k] for k in judged]
        error, spreads = _judge(_features(some, geometry), _travel(some, geometry), geometry)
        far = [(k, rows[k], off) for k, off, apart in zip(judged, error, spreads, strict=True) if apart > _SPREADS]
        if not far:
            break
        for k, row, off in far:
            found[k] = (
                f"{row.name}: depth {row.depth_mm:.2f} mm is stated, {row.depth_mm + off:.2f} mm is what "
                f"the other presses say of a ball of {row.radius_mm:g} mm"
            )
    return tuple(Disagreement(k, found[k]) for k in sorted(found))


def agreement_mm(rows: Sequence[Evidence], geometry: Geometry) -> float:
    """Mean error of each press predicted from all the others, the ball and the place being known."""
    error, _ = _judge(_features(rows, geometry), _travel(rows, geometry), geometry)
    return float(np.mean(np.abs(error)))


def hints(rows: Sequence[Evidence], geometry: Geometry) -> tuple[str, ...]:
    """Other readings of the whole table that fit clearly better than the stated one: units, zero, axes."""
    unit = _unit_hint(rows, geometry)
    return tuple(hint for hint in (unit, _axes_hint(rows), "" if unit else _zero_hint(rows, geometry)) if hint)


def coverage(rows: Sequence[Evidence], geometry: Geometry) -> tuple[str, ...]:
    """What is missing in the presses, a line each."""
    if not rows:
        return ()
    visible_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    places = np.array([row.place_mm for row in rows])
    spread = float(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean())) / visible_mm
    depth = np.array([row.depth_mm for row in rows])
    radius = np.array([row.radius_mm for row in rows])
    said = []
    if len(rows) < _FEW:
        said.append(f"{len(rows)} presses: 20 to 40 make the depth and its error more certain")
    if spread < _SPREAD_RHO:
        mean_x, mean_y = (round(float(v)) for v in places.mean(axis=0))
        said.append(
            f"the presses lie close together, around x {mean_x}, y {mean_y} mm: "
            f"depth elsewhere is a guess; add presses up to {0.66 * visible_mm:.0f} mm from the middle"
        )
    elif sides := _empty_sides(places, visible_mm):
        said.append(f"no press lies {sides}: add some up to {0.66 * visible_mm:.0f} mm from the middle")
    low, high = float(depth.min()), float(depth.max())
    wanted = geometry.skin_radius_mm / 40, geometry.skin_radius_mm / 5
    if high < _DEPTH_RATIO * low:
        said.append(
            f"the presses are all {low:.1f} to {high:.1f} mm deep: other depths are a guess; "
            f"add some from {wanted[0]:.1f} to {wanted[1]:.1f} mm"
        )
    elif high < 0.6 * wanted[1]:
        said.append(
            f"no press is deeper than {high:.1f} mm: what is deeper is saturated; add some to {wanted[1]:.1f} mm"
        )
    if radius.max() < _RADIUS_RATIO * radius.min():
        small, large = float(radius.min()), float(radius.max())
        radii = f"one ball radius, {small:g} mm" if small == large else f"ball radii of {small:g} to {large:g} mm only"
        said.append(
            f"{radii}: smaller and larger things are less certain; "
            f"add balls from {0.15 * geometry.skin_radius_mm:.0f} to {0.45 * geometry.skin_radius_mm:.0f} mm"
        )
    return tuple(said)


def _empty_sides(places: F64, visible_mm: float) -> str:
    """Which halves of the disc, away from its middle, no press reached."""
    reach = 0.25 * visible_mm
    sides = {
        "at x < 0": places[:, 0].min() > -reach,
        "at x > 0": places[:, 0].max() < reach,
        "at y < 0": places[:, 1].min() > -reach,
        "at y > 0": places[:, 1].max() < reach,
    }
    return " or ".join(name for name, empty in sides.items() if empty)


def first_touch_mm(rows: Sequence[Evidence], geometry: Geometry) -> F64:
    """Depth (as PRESSES.csv has it) at which each ball first touches the skin: 0 in the middle, below 0 beside it."""
    r = geometry.skin_radius_mm
    places = np.array([row.place_mm for row in rows])
    radius = np.array([row.radius_mm for row in rows])
    q = np.minimum((places**2).sum(axis=1), (0.999 * r) ** 2)
    return np.asarray(np.sqrt(r * r - q) - (np.sqrt((r + radius) ** 2 - q) - radius))


def _travel(rows: Sequence[Evidence], geometry: Geometry) -> F64:
    return np.array([row.depth_mm for row in rows]) - first_touch_mm(rows, geometry)


def _features(rows: Sequence[Evidence], geometry: Geometry) -> F64:
    scale = 20 / geometry.skin_radius_mm
    visible_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    places = np.array([row.place_mm for row in rows])
    rho2 = np.minimum((places**2).sum(axis=1) / visible_mm**2, 1.5)
    columns = [
        np.ones(len(rows)),
        np.log([row.chi_grey for row in rows]),
        rho2,
        rho2**2,
        np.log([scale * row.radius_mm for row in rows]),
        np.log([scale**2 * row.area_mm2 for row in rows]),
        np.log([row.peak_grey for row in rows]),
    ]
    return np.stack(columns, axis=1)


def _judge(features: F64, travel_mm: F64, geometry: Geometry) -> tuple[F64, F64]:
    """Robust fit of all presses; each press against the fit without it.

    Returns
    -------
    error_mm : float64 (N,)
        Found travel less the stated one.
    spreads : float64 (N,)
        The same in robust standard deviations of all presses, less where the press alone decides the fit.
    """
    scale = 20 / geometry.skin_radius_mm
    travel = np.maximum(scale * travel_mm, 0.05)
    log_travel, floor = np.log(travel), _FLOOR_MM / travel
    # A given error in mm is a larger ratio of a shallow press.
    trust = 1 / (1 + (floor / 0.1) ** 2)
    weight = trust
    pull = np.diag([0.0] + [1.0] * (features.shape[1] - 1))
    for _ in range(_ROUNDS):
        prior = _PULL * float(weight.sum()) * pull
        normal = (features * weight[:, None]).T @ features + prior
        residual = log_travel - features @ np.linalg.solve(
            normal, (features * weight[:, None]).T @ log_travel + prior @ _PRIOR
        )
        spread = np.hypot(max(1.4826 * float(np.median(np.abs(residual))), _LEAST_SPREAD), floor)
        z = np.abs(residual) / spread
        kept = np.where(z < 1.5, 1.0, 1.5 / np.maximum(z, 1.5)) * (z < _SPREADS)
        if not kept.any():
            break
        weight = trust * kept
    leverage = weight * np.einsum("ij,ij->i", features, np.linalg.solve(normal, features.T).T)
    without = residual / (1 - np.minimum(leverage, 0.9))
    error = (np.exp(np.clip(-without, -5, 5)) - 1) * travel / scale
    return error, np.abs(without) * np.sqrt(1 - np.minimum(leverage, 0.9)) / spread


def _misplaced(rows: Sequence[Evidence], geometry: Geometry) -> dict[int, str]:
    """Presses far from where they are stated, beyond what all of them are."""
    stated = [k for k, row in enumerate(rows) if row.x_mm is not None and row.y_mm is not None]
    if not stated:
        return {}
    off = np.array([_place_error(rows[k], rows[k].place_mm) for k in stated])
    scale = geometry.skin_radius_mm / 20
    limit = min(max(_PLACE_MM * scale, _PLACE_MEDIANS * float(np.median(off))), _PLACE_MOST_MM * scale)
    found = {}
    for k, error in zip(stated, off, strict=True):
        if error > limit:
            row, (x, y) = rows[k], rows[k].place_mm
            found[k] = (
                f"{row.name}: x {x:.1f}, y {y:.1f} mm is stated, "
                f"x {row.found_x_mm:.1f}, y {row.found_y_mm:.1f} mm is what the image shows"
            )
    return found


def _place_error(row: Evidence, place: tuple[float, float]) -> float:
    return math.hypot(row.found_x_mm - place[0], row.found_y_mm - place[1])


def _error(rows: Sequence[Evidence], travel_mm: F64, geometry: Geometry) -> float:
    """Mean error of the fit in mm, each press capped so that a few wrong ones do not decide."""
    cap = _ERROR_CAP_MM * geometry.skin_radius_mm / 20
    error, _ = _judge(_features(rows, geometry), travel_mm, geometry)
    return float(np.mean(np.minimum(np.abs(error), cap)))


def _unit_hint(rows: Sequence[Evidence], geometry: Geometry) -> str:
    log_chi = np.log([row.chi_grey for row in rows])
    usual = np.exp(_ANY_SENSOR[0] + _ANY_SENSOR[1] * log_chi) * geometry.skin_radius_mm / 20
    factor = float(np.median(usual / np.array([row.depth_mm for row in rows])))
    if factor < _UNIT_FACTOR:
        return ""
    unit = min(_UNITS, key=lambda name: abs(math.log(_UNITS[name] / factor)))
    return f"the images show presses about {factor:.0f} times as deep as stated: are the depths in {unit}?"


def _axes_hint(rows: Sequence[Evidence]) -> str:
    stated = [row for row in rows if row.x_mm is not None and row.y_mm is not None]
    if len(stated) < 4:
        return ""
    readings = {
        "x and y are swapped": (0, 1, 1, 0),
        "x has the other sign": (-1, 0, 0, 1),
        "y has the other sign": (1, 0, 0, -1),
        "x and y have the other sign": (-1, 0, 0, -1),
        "the axes are turned by 90 degrees": (0, -1, 1, 0),
        "the axes are turned by -90 degrees": (0, 1, -1, 0),
        "x and y are in cm": (10, 0, 0, 10),
        "x and y are in m": (1000, 0, 0, 1000),
    }

    def median_error(a: float, b: float, c: float, d: float) -> float:
        places = [
            (a * row.place_mm[0] + b * row.place_mm[1], c * row.place_mm[0] + d * row.place_mm[1]) for row in stated
        ]
        return float(np.median([_place_error(row, place) for row, place in zip(stated, places, strict=True)]))

    as_stated = median_error(1, 0, 0, 1)
    best = min(readings, key=lambda name: median_error(*readings[name]))
    error = median_error(*readings[best])
    if error > _PLACE_PART * as_stated or as_stated < _PLACE_MM / 2:
        return ""
    return f"the places fit within {error:.1f} mm, not {as_stated:.1f} mm, if {best}"


def _zero_hint(rows: Sequence[Evidence], geometry: Geometry) -> str:
    """Whether another zero of the depth fits better: first touch, or the same offset for all."""
    depth, touch = np.array([row.depth_mm for row in rows]), first_touch_mm(rows, geometry)
    as_stated = _error(rows, depth - touch, geometry)
    scale = geometry.skin_radius_mm / 20
    as_travel = _error(rows, depth, geometry)
    if as_travel < _TRAVEL_PART * as_stated:
        return (
            "the stated depths fit better as travel from first touch; depth_mm is the undeformed skin's z at (x, y) "
            "less the z of the ball's lowest point (docs/calibration.md)"
        )
    offsets = [c * scale for c in np.arange(-1.5, 1.6, 0.25) if float((depth - touch).min()) + c * scale > 0.1]
    if not offsets:
        return ""
    best = min(offsets, key=lambda c: _error(rows, depth - touch + c, geometry))
    if abs(best) < _LEAST_OFFSET_MM * scale or _error(rows, depth - touch + best, geometry) > _OFFSET_PART * as_stated:
        return ""
    change = f"{abs(best):.1f} mm {'more' if best > 0 else 'less'}"
    return f"the depths fit better if all are {change}: check the zero of the depth"
