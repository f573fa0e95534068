"""What the image of a press shows, next to the stated values.

The white ratio follows the skin's local shape, not its depth. What grows with depth is how much
skin changed: the brightening inside the contact, and even more the darkening of its rim, which wide
and narrow objects share. The screened Poisson equation sums both over a neighbourhood (P. Bhat et
al., ECCV 2008).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from tacshade_edge.calibration.indenters import Ball, PlacedIndenter
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.sensor.geometry.disc import DiscRays, skin_points
from tacshade_edge.sensor.image.preprocess import GreyMaps, Preprocessor
from tacshade_edge.types import F32, F64, Geometry

# χ = ψ^(1-w) ψ⁻^w, ψ from all change, ψ⁻ from the darkening, plus a floor (grey levels), so that a
# contact without a visible rim has a depth; ℓ of the screened Poisson equation, in skin sizes.
DARKENING_WEIGHT, DARKENING_FLOOR, REACH_RADII = 0.5, 0.3, 0.4
# Part of the reach for the brightening, so that the bright spots between pins merge into one patch.
# Skin around a contact's dark rim brightens a little too: subtract this much (grey levels).
BRIGHTENING_REACH, LEAST_BRIGHTENING = 0.22, 6.0
# Radius of a usual ball, in skin sizes.
_USUAL_BALL_RADII = 0.3


def screened_poisson(change: F32, reach_cells: float) -> F32:
    """Solve ψ - ℓ² ∇²ψ = change by a cosine transform (mirrored borders): a mean over a
    neighbourhood of ℓ cells.
    """
    rows, cols = change.shape
    even = cv2.copyMakeBorder(
        change, 0, rows % 2, 0, cols % 2, cv2.BORDER_REPLICATE
    )  # cv2.dct takes even sizes
    spectrum = cv2.dct(even)
    n, m = even.shape
    ky = 2 - 2 * np.cos(np.pi * np.arange(n, dtype=np.float32) / n)
    kx = 2 - 2 * np.cos(np.pi * np.arange(m, dtype=np.float32) / m)
    spectrum /= 1 + np.float32(reach_cells**2) * (ky[:, None] + kx[None, :])
    psi: F32 = cv2.idct(spectrum)[:rows, :cols]
    return psi


def _within_disc(change: F32, reach_cells: float) -> F32:
    """ψ of a change inside a disc: pads the window with zeros and clips rounding errors below 0."""
    # A mirrored border would count a change at the rim twice; two reaches of zeros keep it away.
    m = 2 * math.ceil(reach_cells)
    return np.maximum(screened_poisson(np.pad(change, m), reach_cells)[m:-m, m:-m], 0)


def screened_change(maps: GreyMaps, reach_cells: float) -> F32:
    """χ in grey levels, 0 outside the disc; values that are not finite count as 0."""
    g_d = _finite_change(maps)
    psi = _within_disc(np.abs(g_d), reach_cells)
    darkening = _within_disc(np.maximum(-g_d, 0), reach_cells) + np.float32(DARKENING_FLOOR)
    chi = psi ** np.float32(1 - DARKENING_WEIGHT) * darkening ** np.float32(DARKENING_WEIGHT)
    return np.where(maps.inside, chi, np.float32(0)).astype(np.float32)


def screened_brightening(maps: GreyMaps, reach_cells: float) -> F32:
    """Screened brightening inside the contacts, one patch for each; grey levels."""
    bright = np.maximum(_finite_change(maps) - np.float32(LEAST_BRIGHTENING), 0)
    return _within_disc(bright, BRIGHTENING_REACH * reach_cells)


def _finite_change(maps: GreyMaps) -> F32:
    """g_d clipped to its range, 0 outside the disc and where it is not finite."""
    good = np.isfinite(maps.g_d) & maps.inside
    return np.where(good, np.clip(maps.g_d, -255, 255), np.float32(0)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class PressObservation:
    """The stated and observed values of one press."""

    name: str
    change_grey: float  # greatest screened change χ
    brightening_grey: float  # greatest screened brightening
    bright_mm2: float  # area of skin that brightens by at least half of that
    located_x_mm: float  # where the skin brightens most
    located_y_mm: float
    radius_mm: float  # stated, or for another indenter that of a usual ball
    depth_mm: float
    x_mm: float | None
    y_mm: float | None
    indenter: str = ""  # its name; empty for a ball
    touch_mm: float = 0.0  # depth at which another indenter first touches the skin
    reach_mm: float = (
        0.0  # greatest distance from (x, y) at which another indenter may brighten the skin most
    )
    seen_depth_mm: float = (
        math.nan
    )  # greatest height that a network sees; it locates the press far more exactly
    ball_factor: float = (
        math.nan
    )  # radius that fits the heights best, at any factor on them, over the stated one
    misfit_ratio: float = 1.0  # how many times worse the stated radius fits
    # (3, N): column and row from the disc's centre in px, and height in mm,
    # of the cells where a network sees contact
    seen_cells: F64 = field(default_factory=lambda: np.zeros((3, 0)), compare=False)

    @property
    def is_seen(self) -> bool:
        """Whether a network saw and located the press."""
        return math.isfinite(self.seen_depth_mm)

    @property
    def place_mm(self) -> tuple[float, float]:
        """The stated place (x, y), or else the located one; mm."""
        if self.x_mm is None or self.y_mm is None:
            return self.located_x_mm, self.located_y_mm
        return self.x_mm, self.y_mm

    def place_error_mm(self, x_mm: float, y_mm: float) -> float:
        """Distance in mm from the located place to (x, y), less the reach of an indenter there."""
        return max(
            math.hypot(self.located_x_mm - x_mm, self.located_y_mm - y_mm) - self.reach_mm, 0.0
        )


def observe_press(
    preprocessor: Preprocessor, maps: GreyMaps, press: KnownPress
) -> PressObservation:
    """Measure the change in the grey maps of a press with the sensor's preprocessor."""
    geometry = preprocessor.calibration.geometry
    reach = REACH_RADII * geometry.size_mm / (preprocessor.profile.stride_px * geometry.mm_per_px)
    change = screened_change(maps, reach)
    bright = screened_brightening(maps, reach)
    brightest = np.unravel_index(int(np.argmax(bright)), bright.shape)
    # The brightest skin lies about as deep as stated, so its ray meets the dome further in.
    height = np.full(change.shape, press.depth_mm, dtype=np.float32)
    located = skin_points(height, preprocessor.rays, geometry)[brightest]
    made = PressObservation(
        name=press.name,
        change_grey=max(float(change.max()), 1e-3),
        brightening_grey=max(float(bright.max()), 0.1),
        bright_mm2=max(float(np.count_nonzero(bright > 0.5 * bright.max())), 1.0)
        * preprocessor.cell_mm2,
        located_x_mm=float(located[0]),
        located_y_mm=float(located[1]),
        radius_mm=press.radius_mm,
        depth_mm=press.depth_mm,
        x_mm=press.x_mm,
        y_mm=press.y_mm,
    )
    if press.indenter is None:
        return made
    placed = press.placed(geometry.skin_radius_mm)
    assert isinstance(placed, PlacedIndenter)
    return replace(
        made,
        radius_mm=_USUAL_BALL_RADII * geometry.size_mm,
        indenter=press.indenter.name,
        touch_mm=placed.first_touch_mm(geometry.skin_radius_mm),
        reach_mm=_reach_mm(placed, preprocessor.rays, geometry),
    )


def _reach_mm(placed: PlacedIndenter, rays: DiscRays, geometry: Geometry) -> float:
    """Greatest distance from (x, y) at which an indenter is visible inside the undeformed skin, mm;
    0 if nowhere.
    """
    height = placed.height_mm(rays, geometry)
    x, y, _ = skin_points(height, rays, geometry)[np.isfinite(height)].T
    return float(np.hypot(x - placed.x_mm, y - placed.y_mm).max(initial=0.0))


def with_stated_place(observations: Sequence[PressObservation]) -> list[PressObservation]:
    """The observations with stated x and y."""
    return [o for o in observations if o.x_mm is not None and o.y_mm is not None]


def position_mae_mm(observations: Sequence[PressObservation]) -> float:
    """Mean distance of the located from the stated places, mm; 0 if none is stated."""
    errors = [o.place_error_mm(*o.place_mm) for o in with_stated_place(observations)]
    return float(np.mean(errors)) if errors else 0.0


def first_touch_mm(observations: Sequence[PressObservation], geometry: Geometry) -> F64:
    """Depth (as in PRESSES.csv) at which each indenter first touches, mm:
    for a ball 0 on the axis, less off it.
    """
    r = geometry.skin_radius_mm
    return np.array(
        [
            o.touch_mm if o.indenter else Ball(*o.place_mm, 0, o.radius_mm).first_touch_mm(r)
            for o in observations
        ]
    )
