"""Rigid transforms between frames, in mm; ``a_T_b`` transforms points from frame b to frame a."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .types.geometry import F64, Pose, frozen


@frozen
class Rigid:
    """A rotation (3, 3), then a translation (3,)."""

    rotation: F64
    translation_mm: F64

    def __matmul__(self, inner: Rigid) -> Rigid:
        """``a_T_b @ b_T_c`` is ``a_T_c``."""
        return Rigid(
            self.rotation @ inner.rotation,
            self.rotation @ inner.translation_mm + self.translation_mm,
        )

    def apply(self, points_mm: npt.NDArray[np.floating]) -> F64:
        """Transform points (..., 3) in mm."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def inverse(self) -> Rigid:
        """The inverse transform: ``b_T_a`` from ``a_T_b``."""
        return Rigid(self.rotation.T, -(self.rotation.T @ self.translation_mm))

    def seven(self) -> tuple[float, ...]:
        """x, y, z in mm and the unit quaternion w, x, y, z with w >= 0,
        as files and messages hold them.
        """
        return (*self.translation_mm.tolist(), *_quaternion(self.rotation))


def from_seven(values: Sequence[float]) -> Rigid:
    """Make a transform from x, y, z in mm and a quaternion w, x, y, z, which is normalised.

    Raises ValueError if its length is 0.
    """
    x_mm, y_mm, z_mm, *q = values
    norm = math.sqrt(math.fsum(v * v for v in q))
    # Written so that NaN is refused as well.
    if not norm > 0:
        raise ValueError("a quaternion of length 0 is no rotation")
    w, x, y, z = (v / norm for v in q)
    rotation = np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )
    return Rigid(rotation, np.array((x_mm, y_mm, z_mm)))


def of_pose(pose: Pose) -> Rigid:
    """``base_T_flange`` without its time."""
    return from_seven((pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz))


def shift(x_mm: float, y_mm: float, z_mm: float) -> Rigid:
    """A pure translation."""
    return Rigid(np.eye(3), np.array((x_mm, y_mm, z_mm)))


def turn(vector_rad: Sequence[float] | F64) -> Rigid:
    """The rotation about the vector's direction through the origin,
    by its length in radians (Rodrigues).
    """
    x, y, z = (float(v) for v in vector_rad)
    angle = math.sqrt(x * x + y * y + z * z)
    k = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    # sin(a)/a and (1 - cos(a))/a², whose limits at 0 are 1 and 1/2.
    first = float(np.sinc(angle / math.pi))
    second = 0.5 * float(np.sinc(angle / (2 * math.pi))) ** 2
    return Rigid(np.eye(3) + first * k + second * (k @ k), np.zeros(3))


def turned_rad(rotation: F64) -> F64:
    """The rotation vector (3,) in radians, the inverse of `turn`; its length is at most π."""
    w, *v = _quaternion(rotation)
    sine = math.hypot(*v)
    # atan2 stays exact for small angles, where the arc cosine of w loses half its digits.
    return np.array(v) * (2 * math.atan2(sine, w) / sine if sine > 0 else 2.0)


def _quaternion(m: F64) -> tuple[float, float, float, float]:
    """The unit quaternion w, x, y, z of a rotation, from its largest component,
    to avoid the root of a tiny number.
    """
    turned = np.array((m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]))
    # All products of two components, times 4.
    products = np.empty((4, 4))
    products[0, 1:] = products[1:, 0] = turned
    products[1:, 1:] = m + m.T
    np.fill_diagonal(
        products,
        (
            1 + m[0, 0] + m[1, 1] + m[2, 2],
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
        ),
    )
    # A row is the quaternion times one component: the largest divides best.
    row = products[int(np.argmax(products.diagonal()))]
    w, x, y, z = (row / np.linalg.norm(row) * (-1 if row[0] < 0 else 1)).tolist()
    return w, x, y, z
