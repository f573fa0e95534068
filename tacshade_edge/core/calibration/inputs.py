"""The user's input to a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.types import IDENTITY_POSE, U8, Binarisation, Disc, Polarity


@dataclass(frozen=True, slots=True)
class Sensor:
    """The user's description of a sensor (SENSOR.yaml); `polarity`, `visible_circle`, `binarisation` and, for
    ``--fit``, the sizes in `print_mm` (by their keys in the file) override what `calibrate` finds.
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


@dataclass(frozen=True, slots=True, eq=False)
class KnownPress:
    """A known press: its image and its row of PRESSES.csv, with the angles of `place`. A ball has a radius, no
    indenter, and no x and y if the image must locate it.
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


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """All input to a calibration, kept so that it can be repeated; grey images only, `renewed` of the latest new
    reference (``calibrate --rezero``).
    """

    sensor: Sensor
    references: tuple[U8, ...]
    presses: tuple[KnownPress, ...] = ()
    renewed: tuple[U8, ...] = ()
