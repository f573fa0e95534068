"""Fit the rigid motion of an object while the same patches of skin hold it, by weighted least squares.

Skin that sticks moves with the object. Its finger sees two components of that motion as shear, at right angles to the
finger's axis z, and one as depth, along the patch's normal n. With d the motion of the object's point at the patch,

    (1 - z zᵀ) d = shear - shear_0          n · d = -(depth - depth_0)          a · ω = twist - twist_0

where a = (z + n / (n · z)) / 2, since twist is the rotation, seen along z, of points in a plane of normal n. Between
two instants n is the mean of both, which is exact for a plane and for a ball on a ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from tacshade_edge.rigid import Rigid, turn
from tacshade_edge.types import F64

Triple = tuple[float, float, float]
LEVER_MM: Final = 20.0
"""Distance from the axis of the point whose travel measures a rotation."""
SHEAR_SD_MM, SHEAR_SD_PART = 0.05, 0.2
"""Standard deviation of a change of shear along each axis, and its increase per mm that the patch moved, from fingers
of a simulated hand on images, with skins that slid in part (`tools.studies.object_motion --drawn`)."""
DEPTH_SD_MM, DEPTH_SD_PART, DEPTH_SD_FAR_MM = 0.07, 0.4, 1.5
"""The same for a change of depth, which grows only over the first 1.5 mm."""
TWIST_SD_RAD: Final = np.radians(4.0)
OBSERVED_SD_MM: Final = 0.8
"""A direction is unobserved if its standard deviation would exceed this after each patch moved by `NOMINAL_MM`."""
NOMINAL_MM: Final = 2.0
UNKNOWN_SD_MM: Final = 50.0
"""Standard deviation reported for unobserved directions."""
_STEPS, _CONVERGED_MM = 5, 0.02  # its square over the lever remains as error
_STEEPEST = 0.2  # n · z of a contact so far off the tip that no camera sees it
_EYE = np.eye(3)


@dataclass(frozen=True, slots=True)
class Patch:
    """One contact of one finger; vectors along the hand's axes: mean place, unit normal into the object, the finger's z
    axis (shear is perpendicular to it, twist about it, None if the contact is too small), mean shear, greatest h.
    """

    place_mm: Triple
    normal: Triple
    axis: Triple
    shear_mm: Triple
    depth_mm: float
    twist_deg: float | None
    slips: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Several patches as arrays, one row each: `place_mm`, `normal`, `axis`, `shear_mm` (n, 3), the others (n,); an
    unknown twist is NaN.
    """

    place_mm: F64
    normal: F64
    axis: F64
    shear_mm: F64
    depth_mm: F64
    twist_rad: F64


def stack(patches: Sequence[Patch]) -> Patches:
    """Convert patches to arrays."""
    rows = np.array(
        [
            (*p.place_mm, *p.normal, *p.axis, *p.shear_mm, p.depth_mm, np.nan if p.twist_deg is None else p.twist_deg)
            for p in patches
        ],
        np.float64,
    ).reshape(len(patches), 14)
    return Patches(rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9:12], rows[:, 12], np.radians(rows[:, 13]))


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """The beginning of a motion: its patches, their mean place, and orthonormal directions (6, k), (6, 6 - k) of a
    small motion about it: three components of translation, three of rotation times `LEVER_MM`.
    """

    start: Patches
    middle_mm: F64
    observed: F64
    unobserved: F64


@dataclass(frozen=True, slots=True, eq=False)
class LinkMotion:
    """The motion since a link's beginning: rotation (3, 3), translation of the link's middle, and the covariance (6, 6)
    of a small motion after it, about the moved middle: mm, rad, without unobserved directions.
    """

    rotation: F64
    translation_mm: F64
    covariance: F64

    def rigid(self, middle_mm: F64) -> Rigid:
        """The motion as a transform of all points of the hand's frame."""
        return Rigid(self.rotation, middle_mm + self.translation_mm - self.rotation @ middle_mm)


AT_REST: Final = LinkMotion(_EYE, np.zeros(3), np.zeros((6, 6)))


def begin(start: Patches) -> Link:
    """Begin a motion at these patches, and find the directions that they will show."""
    count = len(start.depth_mm)
    middle_mm = start.place_mm.mean(axis=0) if count else np.zeros(3)
    weights = _weights(start, start.normal, np.full(count, NOMINAL_MM))
    rows = _jacobian(start.place_mm - middle_mm)
    information = _normal(rows, weights @ rows)
    axes, known = _twist_axes(start, start.normal), np.isfinite(start.twist_rad)
    information[3:, 3:] += axes[known].T @ axes[known]
    values, directions = np.linalg.eigh(information)
    seen = values > OBSERVED_SD_MM**-2
    return Link(start, middle_mm, directions[:, seen], directions[:, ~seen])


def solve(link: Link, now: Patches, guess: LinkMotion) -> LinkMotion:
    """Fit the motion to the same patches now, in the same order, by Gauss-Newton on SE(3) from a first guess."""
    directions = link.observed
    if not directions.shape[1]:
        return guess
    start = link.start
    shear_mm, sunk_mm = now.shear_mm - start.shear_mm, now.depth_mm - start.depth_mm
    normal = 0.5 * (now.normal + start.normal)
    steep = np.maximum((normal * now.axis).sum(axis=1), _STEEPEST)
    along_mm = -(sunk_mm + (normal * shear_mm).sum(axis=1)) / steep
    moved_mm = shear_mm + along_mm[:, None] * now.axis
    # Place at the beginning of the material that touches now, because a rolling contact moves over the object.
    was_mm = now.place_mm - moved_mm - link.middle_mm
    weights = _weights(now, normal, np.sqrt((moved_mm**2).sum(axis=1)))
    twisted_rad = now.twist_rad - start.twist_rad
    known = np.isfinite(twisted_rad)
    axes, twisted_rad = _twist_axes(now, normal)[known], twisted_rad[known] / TWIST_SD_RAD
    twist_rows = axes @ directions[3:]
    rotation, translation_mm = guess.rotation, guess.translation_mm
    damping = UNKNOWN_SD_MM**-2 * np.eye(directions.shape[1])
    for _ in range(_STEPS):
        is_mm = was_mm @ rotation.T
        rest_mm = moved_mm - (is_mm + translation_mm - was_mm)
        rows = _jacobian(is_mm) @ directions
        weighted = weights @ rows
        twist_rest = twisted_rad - axes @ _small_vector(rotation) * LEVER_MM
        # The damping keeps a direction defined that a contact no longer shows after turning over.
        information = _normal(rows, weighted) + twist_rows.T @ twist_rows + damping
        gradient = rest_mm.ravel() @ weighted.reshape(-1, weighted.shape[2]) + twist_rest @ twist_rows
        covariance = np.linalg.inv(information)
        step = directions @ (covariance @ gradient)
        rotation = turn(step[3:] / LEVER_MM).rotation @ rotation
        translation_mm = translation_mm + step[:3]
        if step @ step < _CONVERGED_MM**2:
            break
    scaled = directions.copy()
    scaled[3:] /= LEVER_MM
    return LinkMotion(rotation, translation_mm, scaled @ covariance @ scaled.T)


def _weights(patches: Patches, normal: F64, far_mm: F64) -> F64:
    """Information (n, 3, 3) on the motion at each patch, given how far it moved."""
    z = patches.axis
    of_shear = (SHEAR_SD_MM + SHEAR_SD_PART * far_mm) ** -2
    of_depth = (DEPTH_SD_MM + DEPTH_SD_PART * np.minimum(far_mm, DEPTH_SD_FAR_MM)) ** -2
    return np.asarray(
        of_shear[:, None, None] * (_EYE - z[:, :, None] * z[:, None, :])
        + (of_depth[:, None] * normal)[:, :, None] * normal[:, None, :]
    )


def _twist_axes(patches: Patches, normal: F64) -> F64:
    """The change of each twist, in its standard deviations, with a rotation times the lever: (n, 3)."""
    steep = np.maximum((normal * patches.axis).sum(axis=1), _STEEPEST)
    return np.asarray((patches.axis + normal / steep[:, None]) * (0.5 / (LEVER_MM * TWIST_SD_RAD)))


def _jacobian(arms_mm: F64) -> F64:
    """Jacobian of points, given relative to the middle, by a small motion about the middle: (n, 3, 6)."""
    rows = np.zeros((len(arms_mm), 3, 6))
    rows[:, 0, 0] = rows[:, 1, 1] = rows[:, 2, 2] = 1.0
    x, y, z = (arms_mm / LEVER_MM).T
    rows[:, 0, 4], rows[:, 0, 5] = z, -y
    rows[:, 1, 3], rows[:, 1, 5] = -z, x
    rows[:, 2, 3], rows[:, 2, 4] = y, -x
    return rows


def _normal(rows: F64, weighted: F64) -> F64:
    """The sum of rowsᵀ · weighted over all patches."""
    size = rows.shape[2]
    return np.asarray(rows.reshape(-1, size).T @ weighted.reshape(-1, size))


def _small_vector(rotation: F64) -> F64:
    """The rotation vector times its sine over its length, which is close enough because a link's motion is small."""
    m = rotation
    return 0.5 * np.array((m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]))
