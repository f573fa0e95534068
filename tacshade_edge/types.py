"""The values that the layers hand each other. Frozen; every array in them is read-only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Flag, IntEnum
from typing import Literal

import numpy as np
import numpy.typing as npt

from tacshade_edge.reasons import Reason

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

Polarity = Literal["bright", "dark"]
Binarisation = Literal["adaptive", "global", "otsu"]

_MOST, _LEAST = 1e6, 1e-6
"""No length, scale or factor of a sensor comes near them, in mm or px; only its camera may lie at its middle."""

IDENTITY_POSE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def freeze(value: object, *names: str) -> None:
    """Replace the named array attributes by read-only views."""
    for name in names:
        view = getattr(value, name).view()
        view.setflags(write=False)
        object.__setattr__(value, name, view)


@dataclass(frozen=True, slots=True)
class Pose:
    """``base_T_flange`` at a time: translation in mm and the unit quaternion w, x, y, z."""

    t_ns: int
    x_mm: float
    y_mm: float
    z_mm: float
    qw: float
    qx: float
    qy: float
    qz: float


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of the sensor's camera.

    Attributes
    ----------
    seq : int
        Counts the frames of this source from 0; a gap is a frame that the source knows it lost.
    t_ns : int
        Capture time, CLOCK_MONOTONIC.
    wall_ns : int
        The same instant as Unix time, for metadata only.
    image : uint8 (H, W) grey or (H, W, 3) BGR
    pose : Pose or None
        ``base_T_flange`` at `t_ns`, where known.
    pose_error_us : int
        How far from `t_ns` the pose is known; 0 without one.
    """

    seq: int
    t_ns: int
    wall_ns: int
    image: U8
    pose: Pose | None = None
    pose_error_us: int = 0

    def __post_init__(self) -> None:
        freeze(self, "image")


@dataclass(frozen=True, slots=True)
class Disc:
    """The visible circle in the image; pixel centres are integers."""

    row_c: float
    col_c: float
    radius_px: float


@dataclass(frozen=True, slots=True)
class Geometry:
    """Skin, camera and visible circle: all that turns a pixel into a ray.

    Attributes
    ----------
    skin_radius_mm : float
        r, the radius of the undeformed skin, centred at O.
    camera_distance_mm : float or None
        d, the lens is at (0, 0, -d); None is the paper's orthographic camera.
    visible_half_angle_deg : float
        θ of the visible circle, measured at O from +z.
    disc : Disc
    """

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    disc: Disc

    @property
    def f_px(self) -> float:
        """Focal length of the pinhole in px; 0 for the orthographic camera."""
        if self.camera_distance_mm is None:
            return 0.0
        theta = math.radians(self.visible_half_angle_deg)
        r = self.skin_radius_mm
        return self.disc.radius_px * (r * math.cos(theta) + self.camera_distance_mm) / (r * math.sin(theta))

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel in the plane of the visible circle (r sinθ / R_px)."""
        theta = math.radians(self.visible_half_angle_deg)
        return self.skin_radius_mm * math.sin(theta) / self.disc.radius_px


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """Radial deformation on a grid of the image.

    Attributes
    ----------
    height_mm : float32 (rows, cols)
        h, positive inwards, of the deformed skin point that the pixel's ray meets; NaN outside the disc.
    contact : bool (rows, cols)
        Where the skin touches an object.
    row0, col0, step_px : float
        Grid cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px); not whole pixels in general.
    """

    height_mm: F32
    contact: Bool
    row0: float
    col0: float
    step_px: float

    def __post_init__(self) -> None:
        freeze(self, "height_mm", "contact")


@dataclass(frozen=True, slots=True, eq=False)
class ObjectCloud:
    """Points of the contacted skin.

    Attributes
    ----------
    points_mm : float32 (N, 3)
        x, y, z in the sensor frame.
    labels : uint16 (N,)
        Object number of each point, from 1.
    """

    points_mm: F32
    labels: U16

    def __post_init__(self) -> None:
        freeze(self, "points_mm", "labels")


class Need(Flag):
    """How much of a frame is asked for; both the displacement and the error of depth have depth with them."""

    CONTACT = 0
    DEPTH = 1
    SHEAR = 3
    SIGMA = 5
    ALL = 7


class Slip(IntEnum):
    """How an object holds the skin that it touches."""

    STICK = 0
    PARTIAL = 1
    FULL = 2


@dataclass(frozen=True, slots=True)
class TouchedObject:
    """One connected contact.

    Attributes
    ----------
    label : int
        From 1, the greatest area first.
    centroid_mm, extent_mm : (float, float, float)
        Mean, and max - min, of its points.
    depth_max_mm : float
        Its greatest h.
    area_mm2 : float
    normal : (float, float, float)
        Unit normal of the plane through its points, away from the camera.
    shear_mm : (float, float) or None
        Mean displacement along x and y of the skin that it touches; None where the solver tells none.
    twist_deg : float or None
        Angle about z, from x towards y, of the least-squares rotation of that skin; None also where it is too small.
    strain_mm : float or None
        Root mean square of what displacement and rotation leave: nothing of skin that it holds.
    id : int or None
        The same while it touches, from frame to frame; None of a single image, as what follows.
    slip : Slip or None
    slip_mm_s : float or None
        Speed of its imprint over the skin.
    """

    label: int
    centroid_mm: tuple[float, float, float]
    extent_mm: tuple[float, float, float]
    depth_max_mm: float
    area_mm2: float
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    shear_mm: tuple[float, float] | None = None
    twist_deg: float | None = None
    strain_mm: float | None = None
    id: int | None = None
    slip: Slip | None = None
    slip_mm_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """What one frame gave.

    Attributes
    ----------
    seq, t_ns, wall_ns : int
        The frame's.
    profile : str
    valid : bool
        False: the frame could not be used, `reason` says why; height 0 inside the disc.
    reason : Reason or None
        None when valid.
    contact : bool
        Without contact, height is exactly 0 inside the disc and the cloud is empty.
    saturated : bool
        The grey left the range that the calibration covers: depth is a lower bound.
    degraded : Reason or None
        Why the result deserves less trust (glare, light drift).
    height : HeightMap
    cloud : ObjectCloud
    objects : tuple of TouchedObject
        In the order of their labels, the greatest first.
    volume_mm3 : float
        Displaced volume under the contacts.
    repaired_px : int
        Pixels whose solver value was not finite and was replaced.
    shear_mm : float32 (rows, cols, 2) or None
        Displacement along x and y, from every cause, of the skin that a cell's ray meets; on the grid of `height`, NaN
        outside the disc, 0 without contact. None where the solver tells none.
    sigma_mm : float32 (rows, cols) or None
        Standard deviation of `height` where its `contact` is true, elsewhere NaN (`core.depth.sigma`). None where the
        solver tells none.
    untrusted : bool (rows, cols) or None
        Cells that do not show the sensor's skin: their values say nothing, and they are no contact. None: no cell.
    """

    seq: int
    t_ns: int
    wall_ns: int
    profile: str
    valid: bool
    reason: Reason | None
    contact: bool
    saturated: bool
    degraded: Reason | None
    height: HeightMap
    cloud: ObjectCloud
    objects: tuple[TouchedObject, ...] = ()
    volume_mm3: float = 0.0
    repaired_px: int = 0
    shear_mm: F32 | None = None
    sigma_mm: F32 | None = None
    untrusted: Bool | None = None

    def __post_init__(self) -> None:
        for name in ("shear_mm", "sigma_mm", "untrusted"):
            if getattr(self, name) is not None:
                freeze(self, name)

    @property
    def shear_of_contact_mm(self) -> tuple[float, float] | None:
        """Mean displacement over all cells of the contact; None without contact or where none is told."""
        if self.shear_mm is None or not self.contact:
            return None
        x_mm, y_mm = self.shear_mm[self.height.contact].mean(axis=0, dtype=np.float64).tolist()
        return x_mm, y_mm

    @property
    def depth_max_mm(self) -> float:
        """Greatest h of the touched objects, in mm; 0 without contact."""
        return max((o.depth_max_mm for o in self.objects), default=0.0)


@dataclass(frozen=True, slots=True)
class ProfileFit:
    """How well a refitted profile finds the depth of the presses, each by a refit to all the others.

    Attributes
    ----------
    presses : int
        Those whose contact the profile found.
    depth_mae_mm, depth_worst_mm : float
        Mean and greatest error of the greatest h, mm.
    """

    presses: int
    depth_mae_mm: float
    depth_worst_mm: float


@dataclass(frozen=True, slots=True)
class Fit:
    """How well the ball presses of a calibration agree, with each other and with the refitted profiles.

    Attributes
    ----------
    presses : int
        Those that were used.
    agreement_mae_mm : float
        Mean error of a press's depth predicted from all the others, ball and place being known.
    position_mae_mm : float
        Mean distance of the located from the stated places; 0 where none was stated.
    profiles : mapping of str to ProfileFit
        Of each profile that was refitted.
    """

    presses: int
    agreement_mae_mm: float
    position_mae_mm: float
    profiles: Mapping[str, ProfileFit] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class FittedNetwork:
    """A profile's network that was trained on with a sensor's own presses (``calibrate --fit``).

    Attributes
    ----------
    layout : str
        Of the shipped network that it began with (`inference.onnx_weights`): it runs in no other.
    weights : float32 (P,)
        All of its weights, in the order of the shipped file's.
    correction : float32 (channels, N, N)
        Added to what the sensor's reference adds to the first layer (`core.depth.Network.sense`), whatever reference
        the sensor has by then.
    held_out : int
        Presses that it was not trained with, by which it was chosen.
    error_mm, shipped_error_mm : float
        On those, at the cells where the indenter's surface is known: mean error of h, its own and that of the shipped
        network with its one factor; each indenter counts alike.
    error_scale : float or None
        On σ, as those presses tell (`core.depth.sigma`); None where it was not measured.

    Raises
    ------
    ValueError
        A weight that is not finite, an `error_scale` that is not above 0 or beyond all measure.
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
    """Everything that is known of one sensor; stored as one ``.npz`` by ``storage.calibration.calibration_file``.

    Attributes
    ----------
    geometry : Geometry
    polarity : str
        ``bright`` when contact raises the white ratio, ``dark`` when it lowers it.
    binarisation : str
        The method that made `reference_white`; frames must be binarised alike.
    image_height_px, image_width_px : int
        Size of every frame.
    pitch_px : float
        Marker pitch at the middle of the disc, in px.
    reference_white : uint8 (H, W)
        255 times the mean over the references of the binarised image: eq. 1 is linear, so g0 for any
        window and stride is a box mean of it.
    reference_grey : uint8 (H, W)
        Mean of the references' grey images: the light, and the surround that must not move.
    noise_grey : float
        RMS of g between the references (eq. 1 at the window of the profiles), grey levels.
    alpha : float
        The paper's α: depth of a normalised height of 1, in pixels.
    factors : mapping of str to float
        On h, of each profile that was refitted to presses (`core.calibration.refit.gain`).
    fit : Fit or None
        How good the fit to ball presses is; None without presses.
    fitted : mapping of str to FittedNetwork
        Of each profile that has weights of its own; its factor is not used.
    error_scales : mapping of str to float
        On σ, of each profile whose shipped network's errors presses have told (`core.depth.sigma`).
    flange_T_sensor : 7 floats
        x, y, z in mm, quaternion w, x, y, z.
    crc32 : int
        CRC-32 of the stored content; 0 until it was stored.

    Raises
    ------
    ValueError
        A number that no sensor has: NaN, not above 0, or beyond all measure.
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
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE
    crc32: int = 0

    def __post_init__(self) -> None:
        freeze(self, "reference_white", "reference_grey")
        _check_numbers(self)

    def error_scale(self, profile: str) -> float | None:
        """That of the network that the profile runs, fitted or shipped; None where no presses have told it."""
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
        "alpha": (calibration.alpha, 0 <= calibration.alpha < _MOST),  # the least one halved is 0
        "noise_grey": (calibration.noise_grey, 0 <= calibration.noise_grey <= 255),
    }
    for name, (value, good) in ranges.items():
        if not good:
            raise ValueError(f"{name} is {value}, which no sensor has")
