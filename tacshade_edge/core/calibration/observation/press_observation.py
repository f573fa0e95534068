"""What the image of a press shows, beside what is stated of the press."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.indenters.indenter import Indenter, PlacedIndenter, place
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation.screened_change import (
    REACH_RADII,
    screened_brightening,
    screened_change,
)
from tacshade_edge.core.calibration.reference.references import PROFILE
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.geometry.disc import DiscRays
from tacshade_edge.core.image.grey_maps import GreyMapper
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import F64, Calibration, Geometry

# Radius of a usual ball, in skin radii.
_USUAL_BALL_RADII = 0.3


@dataclass(frozen=True, slots=True)
class PressObservation:
    """One press.

    Attributes
    ----------
    name : str
    change_grey, brightening_grey : float
        Greatest screened change χ and greatest screened brightening; grey levels, above 0.
    bright_mm2 : float
        Skin that brightens by half of the greatest or more.
    located_x_mm, located_y_mm : float
        Where it brightens most.
    radius_mm, depth_mm : float
        As stated; the radius is that of a usual ball for another indenter.
    x_mm, y_mm : float or None
        As stated.
    indenter : str
        Its name; empty for a ball.
    touch_mm : float
        Of another indenter the depth at which it first touches the skin.
    reach_mm : float
        Of another indenter how far beside (x, y) it may brighten the skin most; 0 for a ball.
    ball_factor : float
        As `PressView.ball_factor`; NaN where no network saw a ball.
    misfit_ratio : float
        As `PressView.misfit_ratio`.
    is_seen : bool
        A network located it, far more exactly than the brightening does.
    """

    name: str
    change_grey: float
    brightening_grey: float
    bright_mm2: float
    located_x_mm: float
    located_y_mm: float
    radius_mm: float
    depth_mm: float
    x_mm: float | None
    y_mm: float | None
    indenter: str = ""
    touch_mm: float = 0.0
    reach_mm: float = 0.0
    ball_factor: float = math.nan
    misfit_ratio: float = 1.0
    is_seen: bool = False

    @property
    def place_mm(self) -> tuple[float, float]:
        """The stated place, or the located one."""
        if self.x_mm is None or self.y_mm is None:
            return self.located_x_mm, self.located_y_mm
        return self.x_mm, self.y_mm

    def place_error_mm(self, x_mm: float, y_mm: float) -> float:
        """How far the located place is from another, or from where an indenter there reaches."""
        return max(math.hypot(self.located_x_mm - x_mm, self.located_y_mm - y_mm) - self.reach_mm, 0.0)


def observe_press(preprocessor: Preprocessor, mapper: GreyMapper, press: KnownPress) -> PressObservation:
    """Measure the change in the image of a press, by what prepares the sensor's images and by its grey maps."""
    geometry = preprocessor.calibration.geometry
    reach = REACH_RADII * geometry.skin_radius_mm / (preprocessor.profile.stride_px * geometry.mm_per_px)
    maps = mapper.maps(preprocessor.preprocess(preprocessor.grey(press.image)))
    change = screened_change(maps, reach)
    bright = screened_brightening(maps, reach)
    brightest = np.unravel_index(int(np.argmax(bright)), bright.shape)
    height = np.full(change.shape, press.depth_mm, dtype=np.float32)
    located = skin_points(height, preprocessor.rays, geometry)[brightest]
    indenter, radius_mm, touch_mm, reach_mm = "", press.radius_mm, 0.0, 0.0
    if press.indenter is not None:
        placed = placed_indenter(press, press.indenter, geometry)
        indenter, radius_mm = press.indenter.name, _USUAL_BALL_RADII * geometry.skin_radius_mm
        touch_mm = placed.first_touch_mm(geometry.skin_radius_mm)
        reach_mm = _reach_mm(placed, preprocessor.rays, geometry)
    return PressObservation(
        name=press.name,
        change_grey=max(float(change.max()), 1e-3),
        brightening_grey=max(float(bright.max()), 0.1),
        bright_mm2=max(float(np.count_nonzero(bright > 0.5 * bright.max())), 1.0) * preprocessor.cell_mm2,
        located_x_mm=float(located[0]),
        located_y_mm=float(located[1]),
        radius_mm=radius_mm,
        depth_mm=press.depth_mm,
        x_mm=press.x_mm,
        y_mm=press.y_mm,
        indenter=indenter,
        touch_mm=touch_mm,
        reach_mm=reach_mm,
    )


def pictured_places(unloaded: Calibration, presses: Sequence[KnownPress]) -> F64:
    """Where the images show the balls of presses: float64 (N, 2), x and y in mm in the sensor frame."""
    preprocessor = Preprocessor(unloaded, PROFILE)
    mapper = GreyMapper(preprocessor)
    observed = [observe_press(preprocessor, mapper, press) for press in presses]
    return np.array([(o.located_x_mm, o.located_y_mm) for o in observed])


def placed_indenter(press: KnownPress, indenter: Indenter, geometry: Geometry) -> PlacedIndenter:
    """Where the indenter of a press is, which is no ball. Raises ConfigError where no place is stated."""
    if press.x_mm is None or press.y_mm is None:
        raise ConfigError(f"{press.name}: x_mm, y_mm: found nothing, expected both: they are optional only for a ball")
    angles = press.yaw_deg, press.tilt_x_deg, press.tilt_y_deg
    return place(indenter, geometry.skin_radius_mm, press.x_mm, press.y_mm, press.depth_mm, *angles)


def _reach_mm(placed: PlacedIndenter, rays: DiscRays, geometry: Geometry) -> float:
    """How far beside (x, y) an indenter lies inside the undeformed skin, in sight; 0 where it does not."""
    height = placed.height_mm(rays, geometry)
    x, y, _ = skin_points(height, rays, geometry)[np.isfinite(height)].T
    return float(np.hypot(x - placed.x_mm, y - placed.y_mm).max(initial=0.0))


def with_stated_place(observations: Sequence[PressObservation]) -> list[PressObservation]:
    """Those whose x and y are stated."""
    return [o for o in observations if o.x_mm is not None and o.y_mm is not None]


def position_mae_mm(observations: Sequence[PressObservation]) -> float:
    """Mean distance of the located from the stated places; 0 where none is stated."""
    errors = [o.place_error_mm(*o.place_mm) for o in with_stated_place(observations)]
    return float(np.mean(errors)) if errors else 0.0


def first_touch_mm(observations: Sequence[PressObservation], geometry: Geometry) -> F64:
    """Depth (as PRESSES.csv has it) at which each indenter first touches: 0 in the middle, below 0 beside it."""
    r = geometry.skin_radius_mm
    places = np.array([o.place_mm for o in observations])
    radius = np.array([o.radius_mm for o in observations])
    q = np.minimum((places**2).sum(axis=1), (0.999 * r) ** 2)
    ball = np.sqrt(r * r - q) - (np.sqrt((r + radius) ** 2 - q) - radius)
    return np.where([o.indenter == "" for o in observations], ball, [o.touch_mm for o in observations])
