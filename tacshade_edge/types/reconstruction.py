"""The results of one frame: heights, points, objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Flag, IntEnum

import numpy as np

from tacshade_edge.reasons import Reason
from tacshade_edge.types.geometry import F32, U16, Bool, frozen

QUANTITIES = (
    "depth_mm",
    "tilt_x_deg",
    "tilt_y_deg",
    "shear_x_mm",
    "shear_y_mm",
    "twist_deg",
    "x_mm",
    "y_mm",
    "edge_deg",
    "force_x_n",
    "force_y_n",
    "force_z_n",
    "torque_x_nmm",
    "torque_y_nmm",
    "torque_z_nmm",
)
"""Columns of LABELS.csv; the first six are also known without labels."""


@frozen
class HeightMap:
    """Radial deformation on a grid of the image; grid cell (i, j) is image pixel (row0 + i·step_px,
    col0 + j·step_px). `height_mm`, float32 (rows, cols), is h, positive inwards, of the deformed
    skin point that the pixel's ray meets, or NaN outside the disc; `contact`, bool (rows, cols), is
    where the skin touches an object.
    """

    height_mm: F32
    contact: Bool
    row0: float
    col0: float
    step_px: float


@frozen
class ObjectCloud:
    """Points of the contacted skin, float32 (N, 3), x, y, z in the sensor frame;
    uint16 object numbers (N,) from 1.
    """

    points_mm: F32
    labels: U16


class Need(Flag):
    """How much of a frame is requested: shear and the error of depth include depth, a touch
    includes shear and depth. Every bit has a name (``ONLY``): Python 3.11.2 (Debian 12) drops
    unnamed bits from a union.
    """

    CONTACT = 0
    DEPTH = 1
    ONLY_SHEAR = 2
    ONLY_SIGMA = 4
    ONLY_TOUCH = 8
    SHEAR = DEPTH | ONLY_SHEAR
    SIGMA = DEPTH | ONLY_SIGMA
    TOUCH = SHEAR | ONLY_TOUCH
    ALL = SIGMA | TOUCH


class Slip(IntEnum):
    """How an object holds the skin that it touches."""

    STICK = 0
    PARTIAL = 1
    FULL = 2


@dataclass(frozen=True, slots=True)
class TouchedObject:
    """One object in contact, in order of area from label 1; lengths in mm, in the sensor frame.

    `centroid_mm` and `extent_mm` are mean, and max - min, of its points, `depth_max_mm` its
    greatest h, `normal` that of the plane through its points, away from the camera. `shear_mm` is
    the mean shear of its skin (None if the solver reports none), `twist_deg` the angle about z,
    from x towards y, of that skin's rotation (None also for a tiny contact), `strain_mm` the RMS of
    the rest, 0 for skin that is held. None for a single image: `id`, the same while the object
    touches, `slip`, and `slip_mm_s`, the speed of its imprint over the skin. `name` is that of the
    taught object that it is, `probability` how probably; both are None if it is none of them or
    nothing is taught.
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
    name: str | None = None
    probability: float | None = None


@dataclass(frozen=True, slots=True)
class Touch:
    """Value and standard deviation of each quantity, in the unit of its name, or None if the model
    does not know it; and why not.
    """

    values: Mapping[str, float | None] = field(default_factory=dict)
    sigma: Mapping[str, float | None] = field(default_factory=dict)
    reason: Reason | None = None


@frozen
class Reconstruction:
    """The result of one frame; `seq` and times are the frame's."""

    seq: int
    t_ns: int
    wall_ns: int
    profile: str
    # False: the frame could not be used, `reason` says why, and height is 0 inside the disc.
    valid: bool
    reason: Reason | None
    contact: bool  # without contact, height is exactly 0 inside the disc and the cloud is empty
    saturated: bool  # the grey left the range that the calibration covers: depth is a lower bound
    degraded: Reason | None  # why the result deserves less trust (glare, light drift)
    height: HeightMap
    cloud: ObjectCloud
    objects: tuple[TouchedObject, ...] = ()  # in the order of their labels, the greatest first
    volume_mm3: float = 0.0  # displaced under the contacts
    repaired_px: int = 0  # pixels whose solver value was not finite and was replaced
    # (rows, cols, 2) on the grid of `height`: along x and y, from any cause, of the skin that a
    # cell's ray meets; NaN outside the disc, 0 without contact.
    shear_mm: F32 | None = None
    sigma_mm: F32 | None = None  # (rows, cols), standard deviation of `height` in contact, else NaN
    # (rows, cols): cells that do not show the sensor's skin, never contact.
    untrusted: Bool | None = None
    touch: Touch | None = None  # none also if nobody requested it
    # Something touches, but its depth is unknown; never together with `contact`.
    touched: bool = False

    @property
    def shear_of_contact_mm(self) -> tuple[float, float] | None:
        """Mean shear over all cells of the contact, mm;
        None without contact or if the solver reports none.
        """
        if self.shear_mm is None or not self.contact:
            return None
        if len(self.objects) == 1:
            return self.objects[0].shear_mm
        touched = self.shear_mm.reshape(-1, 2).take(np.flatnonzero(self.height.contact), axis=0)
        x_mm, y_mm = touched.mean(axis=0, dtype=np.float64).tolist()
        return x_mm, y_mm

    @property
    def depth_max_mm(self) -> float:
        """Greatest h of the touched objects, in mm; 0 without contact."""
        return max((o.depth_max_mm for o in self.objects), default=0.0)
