"""The user's input to a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tacshade_edge.core.calibration.indenters.indenter import Indenter
from tacshade_edge.types import IDENTITY_POSE, U8, Binarisation, Disc, Polarity


@dataclass(frozen=True, slots=True)
class Sensor:
    """The user's description of a sensor (SENSOR.yaml).

    `visible_circle` and `binarisation` override what the references show; if None, `calibrate` finds them there. So do
    the sizes of the print in `print_mm`, by their keys in SENSOR.yaml, for ``--fit``.
    """

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    polarity: Polarity
    alpha: float = 15.0
    binarisation: Binarisation | None = None
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE
    visible_circle: Disc | None = None
    print_mm: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class KnownPress:
    """A known press: its image and its row of PRESSES.csv.

    Attributes
    ----------
    name : str
    image : uint8 (H, W) or (H, W, 3)
    radius_mm : float
        Radius of the ball; 0 for another indenter.
    depth_mm : float
    x_mm, y_mm : float or None
        None for a ball that the image must locate.
    indenter : Indenter or None
        None for a ball.
    yaw_deg, tilt_x_deg, tilt_y_deg : float
        Angles as defined by `place`.
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
    """All input to a calibration, kept so that the calibration can be repeated.

    Attributes
    ----------
    sensor : Sensor
    references : tuple of uint8 (H, W)
        Grey images of the unloaded skin.
    presses : tuple of KnownPress
        With grey images.
    renewed : tuple of uint8 (H, W)
        Images of the latest new reference (``calibrate --rezero``); empty if none was taken.
    """

    sensor: Sensor
    references: tuple[U8, ...]
    presses: tuple[KnownPress, ...] = ()
    renewed: tuple[U8, ...] = ()
