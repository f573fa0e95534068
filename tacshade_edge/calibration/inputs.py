"""The user's input to a calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from tacshade_edge.calibration.indenters import Indenter, Placed, place, stated_ball
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import IDENTITY_POSE, U8, Binarisation, Disc, Polarity


@dataclass(frozen=True, slots=True)
class StatedSensor:
    """SENSOR.yaml, with a pad as in `Geometry`; stated circle, polarity, binarisation and, for
    ``--fit``, `print_mm` override what is found.
    """

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    polarity: Polarity | None
    alpha: float = 15.0
    binarisation: Binarisation | None = None
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE
    visible_circle: Disc | None = None
    print_mm: Mapping[str, float] = field(default_factory=dict)
    pad_radius_mm: float | None = None

    @property
    def visible_radius_mm(self) -> float:
        """Radius of the visible circle on the undeformed skin."""
        if self.pad_radius_mm is not None:
            return self.pad_radius_mm
        return self.skin_radius_mm * math.sin(math.radians(self.visible_half_angle_deg))


@dataclass(frozen=True, slots=True, eq=False)
class KnownPress:
    """An image and its row of PRESSES.csv.

    A ball has a radius, no indenter, and no x and y if the image locates it.
    """

    name: str
    image: U8
    radius_mm: float
    depth_mm: float
    x_mm: float | None
    y_mm: float | None
    indenter: Indenter | None = None
    yaw_deg: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0

    def placed(self, skin_radius_mm: float) -> Placed:
        """Its indenter at the stated place. Raises ConfigError if it states none."""
        if self.x_mm is None or self.y_mm is None:
            raise ConfigError(f"{self.name}: x_mm, y_mm: found no values, expected both values")
        if self.indenter is None:
            return stated_ball(skin_radius_mm, self.x_mm, self.y_mm, self.depth_mm, self.radius_mm)
        angles = self.yaw_deg, self.tilt_x_deg, self.tilt_y_deg
        return place(self.indenter, skin_radius_mm, self.x_mm, self.y_mm, self.depth_mm, *angles)


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """A calibration's input, in grey, to repeat it;
    `renewed` is of the latest ``calibrate --rezero``.
    """

    sensor: StatedSensor
    references: tuple[U8, ...]
    presses: tuple[KnownPress, ...] = ()
    renewed: tuple[U8, ...] = ()
