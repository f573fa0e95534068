"""What a person brings to a calibration besides the reference images."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.core.calibration.indenters.indenter import Indenter
from tacshade_edge.types import IDENTITY_POSE, U8, Binarisation, Disc, Polarity


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a person states of a sensor (SENSOR.yaml).

    `visible_circle` and `binarisation` overrule what the references show; None: they are found there.
    """

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    polarity: Polarity
    alpha: float = 15.0
    binarisation: Binarisation | None = None
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE
    visible_circle: Disc | None = None


@dataclass(frozen=True, slots=True, eq=False)
class KnownPress:
    """A known press: its image and the row of PRESSES.csv.

    Attributes
    ----------
    name : str
    image : uint8 (H, W) or (H, W, 3)
    radius_mm : float
        Of the ball; 0 for another indenter.
    depth_mm : float
    x_mm, y_mm : float or None
        None where a ball is to be located.
    indenter : Indenter or None
        None is a ball.
    yaw_deg, tilt_x_deg, tilt_y_deg : float
        As `place` takes them.
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
    """All that a person brought to a calibration, kept so that it can be made again.

    Attributes
    ----------
    sensor : Sensor
    references : tuple of uint8 (H, W)
        Grey images of the unloaded skin.
    presses : tuple of KnownPress
        Their images are grey.
    renewed : tuple of uint8 (H, W)
        Of the last new reference (``calibrate --rezero``); none where there was none.
    """

    sensor: Sensor
    references: tuple[U8, ...]
    presses: tuple[KnownPress, ...] = ()
    renewed: tuple[U8, ...] = ()
