"""Everything that is known about one sensor, as it is stored
(`calibration.files.calibration_file`).

A number's bounds stand with its field; they hold for a calibration that is made and for one
that is read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_type_hints

import numpy as np
from msgspec import Meta

from tacshade_edge.types.geometry import F32, IDENTITY_POSE, U8, Disc, Geometry, freeze
from tacshade_edge.types.known_objects import KnownObject

Polarity = Literal["bright", "dark"]
Binarisation = Literal["adaptive", "global", "otsu"]

# Limits that no length (mm or px), scale or factor of a sensor comes near;
# only a camera distance may be smaller.
_MOST, _LEAST = 1e6, 1e-6
Size = Annotated[float, Meta(gt=_LEAST, lt=_MOST)]
Positive = Annotated[float, Meta(gt=0, lt=_MOST)]
Error = Annotated[float, Meta(ge=0, le=_MOST)]
Coordinate = Annotated[float, Meta(gt=-_MOST, lt=_MOST)]
# `Geometry` and `Disc` are also the client's, which has no msgspec.
_GEOMETRY: dict[type, dict[str, Any]] = {
    Geometry: {
        "skin_radius_mm": Size,
        "camera_distance_mm": Coordinate | None,
        "visible_half_angle_deg": Annotated[float, Meta(gt=_LEAST, le=90)],
        "pad_radius_mm": Size | None,
    },
    Disc: {"row_c": Coordinate, "col_c": Coordinate, "radius_px": Size},
}


@dataclass(frozen=True, slots=True)
class ProfileFit:
    """The presses whose contact a refitted profile found, and errors of their greatest h, each
    judged by a refit to all the others.
    """

    presses: Annotated[int, Meta(ge=0, le=10**6)]
    depth_mae_mm: Error
    depth_worst_mm: Error


@dataclass(frozen=True, slots=True)
class Fit:
    """How well the presses of a calibration agree with each other (a press's depth predicted from
    all the others, with ball and place known), located with stated places (0 if none was stated),
    and with the refitted profiles.
    """

    presses: Annotated[int, Meta(ge=0, le=10**6)]
    agreement_mae_mm: Error
    position_mae_mm: Error
    profiles: Mapping[str, ProfileFit] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RestLimits:
    """What a profile's evidence of a touch exceeds in at most a part of the frames in which nothing
    touches, measured on images of the untouched skin (`sensor.contact.rest`).
    """

    frames: Annotated[int, Meta(ge=1, le=10**9)]  # number of those images
    false_contacts: Annotated[float, Meta(gt=0, lt=1)]  # that part
    height_mm: Annotated[float, Meta(ge=0, lt=_MOST)]  # of the most pressed part of the disc
    local_change: Coordinate  # of the share of white, beyond motion of the whole pattern
    changed_part: Annotated[float, Meta(ge=0, lt=_MOST)]  # of the picture

    def __post_init__(self) -> None:
        require_bounds(self)


@dataclass(frozen=True, slots=True, eq=False)
class FittedNetwork:
    """A profile's network, trained further on a twin of the sensor (``calibrate --fit``).

    Errors are of h on presses, where the indenter's surface is known and each indenter counts
    alike, or without presses on simulated frames.
    """

    layout: str  # of the shipped network that training began with; the weights run in no other
    weights: F32  # (P,), in the order of the shipped file
    held_out: int  # number of presses that decided whether to keep the network
    error_mm: float
    shipped_error_mm: float
    factor: Positive = 1.0  # on h
    # Factor on σ, measured on those presses (`sensor.depth.sigma`).
    error_scale: Positive | None = None

    def __post_init__(self) -> None:
        freeze(self, "weights")
        require_bounds(self)
        if not np.isfinite(self.weights).all():
            raise ValueError("a fitted weight is not finite")


@dataclass(frozen=True, slots=True, eq=False)
class TouchModel:
    """A touch model: D features, m components, n directions, M centres, K functions, Q quantities,
    T terms.
    """

    names: tuple[str, ...]  # of Q quantities, from `QUANTITIES`
    # Digest of those that compute the features (`sensor.inference.network.touch_networks`).
    networks: str
    mean: F32  # (D,) of each feature over the table
    deviation: F32  # (D,) above 0
    # (D, m): standardised features to coordinates whose mean squares over the table add to 1.
    components: F32
    scale: Positive  # length of a standardised feature vector whose coordinates have length 1
    spread: F32  # (m,) standard deviation of each coordinate over the table, descending
    origin: F32  # (m,) coordinates of the untouched skin
    metric: F32
    """(2 m, n) coordinates and their ratios to the directions in which the quantities change
    (older: m rows).
    """
    # Part of the picture from whose change on the model answers.
    gate_part: Annotated[float, Meta(ge=0, le=1)]
    centres: F32  # (M, n)
    width: Size  # of the squared-exponential kernel, which divides by its square
    # (n + M, K): kernel values to the basis functions that vary most
    # and are uncorrelated over the table.
    basis: F32
    weights: F32  # (n + M, Q) of the kernel values in each quantity's mean
    # (K, Q) posterior variance of each basis function's weight, in units of `noise`².
    precision: F32
    ridge: F32  # (Q,) regularisation
    offset: F32  # (Q,) mean over the table
    noise: F32  # (Q,) standard deviation of a label about the model
    low: F32  # (Q,) least label of the table
    high: F32  # (Q,) greatest label of the table
    # A frame is unlike the table's beyond this `leverage` of its coordinates, or beyond this.
    leverage_max: Positive
    residual_max: Positive  # share of its standardised features that the components leave out
    # (T, I): terms of the predicted quantities to their imprint (`sensor.touch.touch_answer`).
    imprint_weights: F32
    # (I, I) inverse covariance of the imprint errors of held-out frames, divided by I.
    imprint_precision: F32
    # Greatest squared distance of an imprint; beyond it an object is unlike the table's.
    imprint_max: Positive

    def __post_init__(self) -> None:
        freeze(self, *TOUCH_ARRAYS)
        require_bounds(self)
        sizes = {"Q": len(self.names)}
        for name, letters in _TOUCH_SHAPES.items():
            array: F32 = getattr(self, name)
            if array.dtype != np.float32 or not array.size or array.ndim != len(letters):
                raise ValueError(
                    f"touch model: {name} is {array.dtype} {array.shape}, "
                    f"expected float32 {letters}"
                )
            if not np.isfinite(array).all():
                raise ValueError(f"touch model: {name} has a value that is not finite")
            for letter, size in zip(letters, array.shape, strict=True):
                if sizes.setdefault(letter, size) != size:
                    raise ValueError(
                        f"touch model: {name} is {array.shape}, which does not fit the other arrays"
                    )
        quantities = sizes["Q"]
        known = sizes["+"] == sizes["n"] + sizes["M"] and sizes["2"] in (sizes["m"], 2 * sizes["m"])
        if not known or sizes["T"] != (quantities + 1) * (quantities + 2) // 2:
            raise ValueError(
                f"touch model: found the sizes {sizes}, expected some that fit each other"
            )
        positive = (self.deviation, self.spread, self.noise, self.ridge)
        if min(array.min() for array in positive) <= 0 or (self.precision < 0).any():
            raise ValueError("touch model: a deviation is not above 0")


# A letter for each size, as in `TouchModel`; + for n + M, 2 for 2 m.
_TOUCH_SHAPES = {
    **{"mean": "D", "deviation": "D", "components": "Dm", "spread": "m", "origin": "m"},
    **{"metric": "2n", "centres": "Mn", "basis": "+K"},
    **{
        "weights": "+Q",
        "precision": "KQ",
        "ridge": "Q",
        "offset": "Q",
        "noise": "Q",
        "low": "Q",
        "high": "Q",
    },
    **{"imprint_weights": "TI", "imprint_precision": "II"},
}
TOUCH_ARRAYS = tuple(_TOUCH_SHAPES)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything that is known about one sensor. A number that no sensor has raises ValueError."""

    geometry: Geometry
    polarity: Polarity  # bright when contact raises the white ratio
    # Method that made `reference_white`; frames must be binarised the same way.
    binarisation: Binarisation
    image_height_px: int  # of every frame
    image_width_px: int
    pitch_px: Size  # of the markers at the middle of the disc
    # (H, W), 255 times the mean of the references' binarised images; g0 is its box mean (eq. 1).
    reference_white: U8
    # (H, W), mean of the references' images: the light, and the surround that must not move.
    reference_grey: U8
    # RMS of g between the references (eq. 1), grey levels.
    noise_grey: Annotated[float, Meta(ge=0, le=255)]
    # The paper's α: depth of a normalised height of 1, in px.
    alpha: Annotated[float, Meta(ge=0, lt=_MOST)]
    # RMS of g_d (eq. 9) over the disc to which α belongs, which grows with it; 0: α is constant.
    alpha_grey: Annotated[float, Meta(ge=0, le=255)] = 0.0
    # On h, of each profile refitted to presses.
    factors: Mapping[str, Size] = field(default_factory=dict)
    fit: Fit | None = None
    # By profile, with its own factor (``calibrate --fit``).
    fitted: Mapping[str, FittedNetwork] = field(default_factory=dict)
    # On σ, of shipped networks measured on presses.
    error_scales: Mapping[str, Size] = field(default_factory=dict)
    # By profile (``calibrate --labels``).
    touch: Mapping[str, TouchModel] = field(default_factory=dict)
    # By profile (``calibrate --rest``).
    rest: Mapping[str, RestLimits] = field(default_factory=dict)
    flange_T_sensor: Annotated[tuple[Coordinate, ...], Meta(min_length=7, max_length=7)] = (
        IDENTITY_POSE
    )
    crc32: int = 0  # of the stored content; 0 until it is stored
    # Objects by name, of each profile; `calibration.files.objects_file` stores them in a file
    # of their own.
    known: Mapping[str, tuple[KnownObject, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "reference_white", "reference_grey")
        for record in (self, self.geometry.disc):
            require_bounds(record)
        _require_geometry(self.geometry)

    def error_scale(self, profile: str) -> float | None:
        """Factor on σ of the network that the profile runs, fitted or shipped;
        None if no presses have shown it.
        """
        fitted = self.fitted.get(profile)
        return self.error_scales.get(profile) if fitted is None else fitted.error_scale


def _require_geometry(geometry: Geometry) -> None:
    """Raise ValueError for a geometry that no sensor has; only a pad's radius is infinite."""
    if geometry.skin == "pad":
        flat = (geometry.skin_radius_mm, geometry.visible_half_angle_deg) == (math.inf, 0.0)
        if not flat:
            raise ValueError("skin_radius_mm and visible_half_angle_deg are not a pad's")
        geometry = replace(geometry, skin_radius_mm=1.0, visible_half_angle_deg=1.0)
    require_bounds(geometry)
    if geometry.camera_distance_mm is not None and not geometry.f_px > 0:
        text = f"camera_distance_mm is {geometry.camera_distance_mm}"
        raise ValueError(f"{text}, a lens in front of the visible circle")


def require_bounds(record: Any) -> None:
    """Raise ValueError if a number of a dataclass, or in a mapping or tuple of it,
    is NaN or outside its bounds.
    """
    kind: Any = type(record)  # mypy takes no type for hashable
    for name, bounds in _bounds(kind).items():
        given = getattr(record, name)
        values = (
            given.values()
            if isinstance(given, Mapping)
            else given
            if isinstance(given, tuple)
            else (given,)
        )
        for value in values:
            if value is not None and not all(
                (each.gt is None or value > each.gt)
                and (each.ge is None or value >= each.ge)
                and (each.lt is None or value < each.lt)
                and (each.le is None or value <= each.le)
                for each in bounds
            ):
                raise ValueError(f"{name} is {value}, which no sensor has")


@cache
def _bounds(kind: type) -> dict[str, tuple[Meta, ...]]:
    """The bounds of a dataclass's numbers by field."""
    hints = _GEOMETRY.get(kind) or get_type_hints(kind, include_extras=True)
    return {name: found for name, hint in hints.items() if (found := tuple(_metas(hint)))}


def _metas(hint: Any) -> list[Meta]:
    return (
        [hint]
        if isinstance(hint, Meta)
        else [meta for part in get_args(hint) for meta in _metas(part)]
    )
