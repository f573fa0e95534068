"""What the image of a ball press shows, beside what is stated of the press."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.inputs import BallPress
from tacshade_edge.core.calibration.screened_change import REACH_RADII, screened_brightening, screened_change
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.image.grey_maps import GreyMapper
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.types import F64, Geometry


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
        As stated.
    x_mm, y_mm : float or None
        As stated.
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

    @property
    def place_mm(self) -> tuple[float, float]:
        """The stated place, or the located one."""
        if self.x_mm is None or self.y_mm is None:
            return self.located_x_mm, self.located_y_mm
        return self.x_mm, self.y_mm

    def place_error_mm(self, x_mm: float, y_mm: float) -> float:
        """How far the located place is from another."""
        return math.hypot(self.located_x_mm - x_mm, self.located_y_mm - y_mm)


def observe_press(preprocessor: Preprocessor, mapper: GreyMapper, press: BallPress) -> PressObservation:
    """Measure the change in the image of a press, by what prepares the sensor's images and by its grey maps."""
    geometry = preprocessor.calibration.geometry
    reach = REACH_RADII * geometry.skin_radius_mm / (preprocessor.profile.stride_px * geometry.mm_per_px)
    maps = mapper.maps(preprocessor.preprocess(preprocessor.grey(press.image)))
    change = screened_change(maps, reach)
    bright = screened_brightening(maps, reach)
    brightest = np.unravel_index(int(np.argmax(bright)), bright.shape)
    height = np.full(change.shape, press.depth_mm, dtype=np.float32)
    located = skin_points(height, preprocessor.rays, geometry)[brightest]
    return PressObservation(
        name=press.name,
        change_grey=max(float(change.max()), 1e-3),
        brightening_grey=max(float(bright.max()), 0.1),
        bright_mm2=max(float(np.count_nonzero(bright > 0.5 * bright.max())), 1.0) * preprocessor.cell_mm2,
        located_x_mm=float(located[0]),
        located_y_mm=float(located[1]),
        radius_mm=press.radius_mm,
        depth_mm=press.depth_mm,
        x_mm=press.x_mm,
        y_mm=press.y_mm,
    )


def with_stated_place(observations: Sequence[PressObservation]) -> list[PressObservation]:
    """Those whose x and y are stated."""
    return [o for o in observations if o.x_mm is not None and o.y_mm is not None]


def position_mae_mm(observations: Sequence[PressObservation]) -> float:
    """Mean distance of the located from the stated places; 0 where none is stated."""
    errors = [o.place_error_mm(*o.place_mm) for o in with_stated_place(observations)]
    return float(np.mean(errors)) if errors else 0.0


def first_touch_mm(observations: Sequence[PressObservation], geometry: Geometry) -> F64:
    """Depth (as PRESSES.csv has it) at which each ball first touches the skin: 0 in the middle, below 0 beside it."""
    r = geometry.skin_radius_mm
    places = np.array([o.place_mm for o in observations])
    radius = np.array([o.radius_mm for o in observations])
    q = np.minimum((places**2).sum(axis=1), (0.999 * r) ** 2)
    return np.asarray(np.sqrt(r * r - q) - (np.sqrt((r + radius) ** 2 - q) - radius))
