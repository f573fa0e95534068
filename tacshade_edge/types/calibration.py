"""Everything that is known about one sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tacshade_edge.types.arrays import F32, U8, freeze
from tacshade_edge.types.frame import IDENTITY_POSE
from tacshade_edge.types.geometry import Geometry
from tacshade_edge.types.touch import TouchModel

Polarity = Literal["bright", "dark"]
Binarisation = Literal["adaptive", "global", "otsu"]

_MOST, _LEAST = 1e6, 1e-6
"""Limits that no length (mm or px), scale or factor of a sensor comes near; only a camera distance may be smaller."""


@dataclass(frozen=True, slots=True)
class ProfileFit:
    """How well a refitted profile finds the depth of presses, each press judged by a refit to all the others.

    Attributes
    ----------
    presses : int
        Presses whose contact the profile found.
    depth_mae_mm, depth_worst_mm : float
        Mean and greatest error of the greatest h, mm.
    """

    presses: int
    depth_mae_mm: float
    depth_worst_mm: float


@dataclass(frozen=True, slots=True)
class Fit:
    """How well the ball presses of a calibration agree with each other and with the refitted profiles.

    Attributes
    ----------
    presses : int
        Presses that were used.
    agreement_mae_mm : float
        Mean error of a press's depth predicted from all the others, with ball and place known.
    position_mae_mm : float
        Mean distance between located and stated places; 0 if none was stated.
    profiles : mapping of str to ProfileFit
        The fit of each refitted profile.
    """

    presses: int
    agreement_mae_mm: float
    position_mae_mm: float
    profiles: Mapping[str, ProfileFit] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class FittedNetwork:
    """A profile's network, trained further with a sensor's own presses (``calibrate --fit``).

    Attributes
    ----------
    layout : str
        Layout of the shipped network that training began with (`inference.onnx_weights`); the weights run in no other.
    weights : float32 (P,)
        All weights, in the order of the shipped file.
    correction : float32 (channels, N, N)
        Added to what the sensor's reference adds to the first layer (`core.depth.Network.sense`), even after the
        reference has changed; 0 in new fits.
    held_out : int
        Number of presses kept out of the training, which decided whether to keep the network.
    error_mm, shipped_error_mm : float
        Mean error of h on those presses, at the cells where the indenter's surface is known, of this network and of
        the shipped one with its one factor; each indenter counts alike.
    error_scale : float or None
        Factor on σ, measured on those presses (`core.depth.sigma`); None if it was not measured.

    Raises
    ------
    ValueError
        A weight is not finite, or `error_scale` is not above 0 or is implausibly large.
    """

    layout: str
    weights: F32
    correction: F32
    held_out: int
    error_mm: float
    shipped_error_mm: float
    error_scale: float | None = None

    def __post_init__(self) -> None:
        freeze(self, "weights", "correction")
        if self.error_scale is not None and not 0 < self.error_scale < _MOST:
            raise ValueError(f"error_scale is {self.error_scale}, which no sensor has")
        if not (np.isfinite(self.weights).all() and np.isfinite(self.correction).all()):
            raise ValueError("a fitted weight is not finite")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything that is known about one sensor; ``storage.calibration.calibration_file`` stores it as one ``.npz``.

    Attributes
    ----------
    geometry : Geometry
    polarity : str
        ``bright`` when contact raises the white ratio, ``dark`` when it lowers it.
    binarisation : str
        Method that made `reference_white`; frames must be binarised the same way.
    image_height_px, image_width_px : int
        Size of every frame.
    pitch_px : float
        Marker pitch at the middle of the disc, in px.
    reference_white : uint8 (H, W)
        255 times the mean of the references' binarised images: eq. 1 is linear, so g0 for any window and stride is a
        box mean of it.
    reference_grey : uint8 (H, W)
        Mean of the references' grey images: the light, and the surround that must not move.
    noise_grey : float
        RMS of g between the references (eq. 1 at the window of the profiles), grey levels.
    alpha : float
        The paper's α: depth of a normalised height of 1, in pixels.
    factors : mapping of str to float
        Factor on h of each profile that was refitted to presses (`core.calibration.refit`).
    fit : Fit or None
        Quality of the fit to ball presses; None without presses.
    fitted : mapping of str to FittedNetwork
        Network of each profile that has weights of its own; the profile's factor is then unused.
    error_scales : mapping of str to float
        Factor on σ of each profile whose shipped network was measured on presses (`core.depth.sigma`).
    touch : mapping of str to TouchModel
        Touch model of each profile that has learnt from labelled frames (``calibrate --labels``).
    flange_T_sensor : 7 floats
        x, y, z in mm, quaternion w, x, y, z.
    crc32 : int
        CRC-32 of the stored content; 0 until it is stored.

    Raises
    ------
    ValueError
        A number is NaN, not above 0, or implausibly large, so that no sensor has it.
    """

    geometry: Geometry
    polarity: Polarity
    binarisation: Binarisation
    image_height_px: int
    image_width_px: int
    pitch_px: float
    reference_white: U8
    reference_grey: U8
    noise_grey: float
    alpha: float
    factors: Mapping[str, float] = field(default_factory=dict)
    fit: Fit | None = None
    fitted: Mapping[str, FittedNetwork] = field(default_factory=dict)
    error_scales: Mapping[str, float] = field(default_factory=dict)
    touch: Mapping[str, TouchModel] = field(default_factory=dict)
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE
    crc32: int = 0

    def __post_init__(self) -> None:
        freeze(self, "reference_white", "reference_grey")
        _check_numbers(self)

    def error_scale(self, profile: str) -> float | None:
        """Factor on σ of the network that the profile runs, fitted or shipped; None if no presses have shown it."""
        fitted = self.fitted.get(profile)
        return self.error_scales.get(profile) if fitted is None else fitted.error_scale


def _check_numbers(calibration: Calibration) -> None:
    geometry = calibration.geometry
    disc, distance_mm = geometry.disc, geometry.camera_distance_mm
    positive = {
        "skin_radius_mm": geometry.skin_radius_mm,
        "radius_px": disc.radius_px,
        "pitch_px": calibration.pitch_px,
        **{f"factor of {name}": factor for name, factor in calibration.factors.items()},
        **{f"error scale of {name}": scale for name, scale in calibration.error_scales.items()},
    }
    ranges = {
        **{name: (value, _LEAST < value < _MOST) for name, value in positive.items()},
        "camera_distance_mm": (distance_mm, distance_mm is None or 0 < distance_mm < _MOST),
        "row_c": (disc.row_c, abs(disc.row_c) < _MOST),
        "col_c": (disc.col_c, abs(disc.col_c) < _MOST),
        "visible_half_angle_deg": (geometry.visible_half_angle_deg, _LEAST < geometry.visible_half_angle_deg <= 90),
        "alpha": (calibration.alpha, 0 <= calibration.alpha < _MOST),  # half of the smallest float is 0
        "noise_grey": (calibration.noise_grey, 0 <= calibration.noise_grey <= 255),
    }
    for name, (value, good) in ranges.items():
        if not good:
            raise ValueError(f"{name} is {value}, which no sensor has")
