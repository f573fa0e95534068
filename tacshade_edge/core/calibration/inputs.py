"""What a person brings to a calibration besides the reference images."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.types import IDENTITY_POSE, U8, Binarisation, Polarity


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a person states of a sensor (SENSOR.yaml)."""

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    polarity: Polarity
    alpha: float = 15.0
    binarisation: Binarisation = "adaptive"
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE


@dataclass(frozen=True, slots=True, eq=False)
class BallPress:
    """A known press of a ball: its image and the row of PRESSES.csv; x and y None where they are to be located."""

    name: str
    image: U8
    radius_mm: float
    depth_mm: float
    x_mm: float | None
    y_mm: float | None
