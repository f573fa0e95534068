"""Fit a plane to each object's contact, and a planar motion to its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F32, F64, I64

TWIST_CELLS = 6
"""Least number of cells for a twist."""


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """The motion of one object's contact since the reference: mean shear of its points; angle about z, from x towards
    y, of the least-squares rotation about their mean (None below `TWIST_CELLS`); RMS of the motion beyond both, 0 for
    skin that an object holds.
    """

    shear_mm: tuple[float, float]
    twist_deg: float | None
    strain_mm: float


def about_mean(values: F32, starts: I64, counts: I64) -> tuple[F64, F64]:
    """The mean of each object's values (dimensions, N), and the values less the mean; float64."""
    means: F64 = np.add.reduceat(values, starts, axis=1, dtype=np.float64) / counts
    return means, np.subtract(values, np.repeat(means, counts, axis=1), dtype=np.float64)


def normals(about_mean_mm: F64, starts: I64) -> F64:
    """Unit normals (objects, 3) of the planes through each object's points, away from the camera (z not below 0). Takes
    points (3, N) less their object's mean, and the index of each object's first point; no object is empty.
    """
    ends = [*starts[1:].tolist(), about_mean_mm.shape[1]]
    objects = [about_mean_mm[:, start:end] for start, end in zip(starts.tolist(), ends, strict=True)]
    covariance = np.stack([points @ points.T for points in objects])
    least: F64 = np.linalg.eigh(covariance)[1][:, :, 0]
    return least * np.where(least[:, 2:] < 0, -1.0, 1.0)


def rigid_motions(about_mean_mm: F64, shear_mm: F32, starts: I64, counts: I64) -> tuple[RigidMotion, ...]:
    """Fit a motion to the points of each object: present x and y (2, N) less their object's mean, and their shear (2,
    N), object by object; index of each object's first point and number of its points, none empty.
    """

    def sums(values: F64) -> F64:
        return np.asarray(np.add.reduceat(values, starts))

    now = about_mean_mm
    shear, moved = about_mean(shear_mm, starts, counts)
    before = now - moved
    # Umeyama 1991, in the plane: these two are proportional to the cosine and sine of the angle.
    along = sums(before[0] * now[0] + before[1] * now[1])
    across = sums(before[0] * now[1] - before[1] * now[0])
    left = sums(np.sum(before**2 + now**2, axis=0)) - 2 * np.hypot(along, across)
    strain = np.sqrt(np.maximum(left, 0) / counts)
    twist = np.degrees(np.arctan2(across, along))
    return tuple(
        RigidMotion((x, y), angle if count >= TWIST_CELLS else None, rest)
        for x, y, angle, count, rest in zip(
            *shear.tolist(), twist.tolist(), counts.tolist(), strain.tolist(), strict=True
        )
    )
