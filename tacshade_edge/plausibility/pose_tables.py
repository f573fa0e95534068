"""Poses of presses against the sensor's size, and against the one surface that all presses show.

A wrong unit, sign or order of the poses makes presses disagree on the height of places that several
of them touched; the right reading makes them agree again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import LENGTHS, UnitName
from tacshade_edge.rigid import from_seven
from tacshade_edge.types import F64, I64

PRESSES_LEAST: Final = 4
"""Of fewer presses, nothing follows."""
_PRESSES_READ: Final = 64
"""So many neighbours show how a table is meant."""
# Of the sensor's size. Presses in a smaller space show one place.
_SPREAD_LEAST: Final = 0.01
# Presses that stand farther from their neighbours make no map.
_APART_MOST: Final = 20.0
# Nor does any robot press that far from the last place all the time.
_APART_MM: Final = 1000.0
# Another reading counts if presses then disagree less than this part as much, which cannot be
# chance below the second; and if it leaves less by this many mm on the nominal skin.
_PART, _PART_SURE, _LEAST_MM = 0.62, 0.5, 0.1
# As do presses at one and the same pose that disagree by more.
_ONE_POSE_MM: Final = 0.25
_OVERLAP_LEAST, _GATHERED = 0.25, 0.5
# A few presses that overlap may agree by chance; so many must as do as stated.
_OVERLAP_KEPT: Final = 0.6
_NOMINAL_MM: Final = 20.0
_POSES_EQUAL_MM, _POSES_EQUAL = 1e-6, 1e-6


class Reading(StrEnum):
    """Another meaning of a table's poses than the stated one, as a question ends."""

    QUATERNION_LAST = "is the quaternion in the order x, y, z, w?"
    INVERSE = "are they flange_T_base?"
    TURNED_BACK = "are the rotations inverse?"
    X_OPPOSITE = "has x the opposite sign?"
    Y_OPPOSITE = "has y the opposite sign?"
    Z_OPPOSITE = "has z the opposite sign?"
    ALL_OPPOSITE = "have the positions the opposite sign?"
    SWAPPED = "are x and y swapped?"
    ROW_BEFORE = "does each image have the pose of the row before?"
    ROW_AFTER = "does each image have the pose of the row after?"


@dataclass(frozen=True, slots=True)
class PressAgreement:
    """How much presses disagree on the heights of places that several touched (RMS, mm; NaN without
    any), and the part of all that they show there.
    """

    rms_mm: float
    overlap: float


Agree = Callable[[I64, F64], PressAgreement]
"""The agreement of the presses with these numbers (K,) at poses (K, 7) of the flange."""


def judge_poses(
    poses: F64, size_mm: float, agree: Agree, *, flange_known: bool = True
) -> Suspicion | None:
    """What is wrong with the poses (N, 7) of presses, x, y, z in mm and a quaternion w, x, y, z.

    `size_mm` is the sensor's. Without a known flange, presses at the right poses disagree too, so
    that only units show.
    """
    if len(poses) < PRESSES_LEAST:
        return None
    near = _neighbours(poses)
    stated = agree(near, poses[near])
    scale = size_mm / _NOMINAL_MM
    spread_mm = float(np.ptp(poses[:, :3], axis=0).max())
    if spread_mm < _POSES_EQUAL_MM and float(np.ptp(poses[:, 3:], axis=0).max()) < _POSES_EQUAL:
        # Presses of one place show one thing.
        disagree = stated.rms_mm > _ONE_POSE_MM * scale
        return suspicion(
            SuspicionCode.ONE_POSE,
            impossible=disagree or not flange_known,
            rows=len(poses),
            rms_mm=stated.rms_mm,
        )
    # Without overlap, any reading that shrinks a scan of a flat surface seems to agree.
    if stated.overlap >= _OVERLAP_LEAST and (
        found := _other_reading(poses, near, stated, agree, scale, flange_known=flange_known)
    ):
        return found
    if stated.overlap < _OVERLAP_LEAST and (found := _gathering(poses, near, agree, scale)):
        return found
    if 0 < spread_mm < _SPREAD_LEAST * size_mm:
        return suspicion(
            SuspicionCode.POSES_CLOSE,
            impossible=not flange_known,
            spread_mm=spread_mm,
            size_mm=size_mm,
            unit=_unit_of_spread(spread_mm, size_mm),
        )
    apart_mm = _apart_mm(poses)
    if apart_mm > _APART_MOST * size_mm:
        return suspicion(
            SuspicionCode.POSES_APART,
            impossible=apart_mm > _APART_MM,
            apart_mm=apart_mm,
            size_mm=size_mm,
            unit=UnitName.MICROMETRE,
        )
    return None


def _neighbours(poses: F64) -> I64:
    """The numbers of the presses that stand nearest to the middle one, in order."""
    middle = np.median(poses[:, :3], axis=0)
    first = int(np.argmin(np.linalg.norm(poses[:, :3] - middle, axis=1)))
    far = np.linalg.norm(poses[:, :3] - poses[first, :3], axis=1)
    return np.sort(np.argsort(far, kind="stable")[:_PRESSES_READ])


def _other_reading(
    poses: F64, near: I64, stated: PressAgreement, agree: Agree, scale: float, *, flange_known: bool
) -> Suspicion | None:
    """A reading of the table with which presses agree far better; None without one."""
    best, most_mm = None, math.inf
    for name, read in _readings(poses):
        if not flange_known and not isinstance(name, UnitName):
            continue
        found = agree(near, read[near])
        if found.overlap >= _OVERLAP_KEPT * stated.overlap and found.rms_mm < most_mm:
            best, most_mm = name, found.rms_mm
    against_mm = stated.rms_mm
    part = most_mm / against_mm if against_mm > 0 else math.inf
    least_mm2 = (_LEAST_MM * scale) ** 2
    if best is None or not part < _PART or not against_mm**2 - most_mm**2 > least_mm2:
        return None
    is_sure = part < _PART_SURE
    if isinstance(best, UnitName):
        return suspicion(
            SuspicionCode.POSES_UNIT,
            impossible=is_sure,
            spread_mm=float(np.ptp(poses[:, :3], axis=0).max()),
            rms_mm=most_mm,
            stated_mm=against_mm,
            unit=best,
        )
    return suspicion(
        SuspicionCode.POSES_READING,
        impossible=is_sure,
        rms_mm=most_mm,
        stated_mm=against_mm,
        reading=best,
    )


def _gathering(poses: F64, near: I64, agree: Agree, scale: float) -> Suspicion | None:
    """A reading of scattered poses with which presses overlap and agree; None without one."""
    for name, read in _readings(poses):
        if isinstance(name, UnitName):
            continue
        found = agree(near, read[near])
        if found.overlap >= _GATHERED and found.rms_mm < _ONE_POSE_MM * scale:
            return suspicion(SuspicionCode.POSES_SCATTERED, rms_mm=found.rms_mm, reading=name)
    return None


def _readings(poses: F64) -> Iterator[tuple[UnitName | Reading, F64]]:
    """All other readings of the poses."""
    at, turned = poses[:, :3], poses[:, 3:]
    for unit, size in LENGTHS.items():
        yield unit, np.hstack((at * size, turned))
    yield Reading.QUATERNION_LAST, np.hstack((at, np.roll(turned, 1, axis=1)))
    yield Reading.TURNED_BACK, np.hstack((at, turned * (1, -1, -1, -1)))
    yield Reading.INVERSE, np.array([from_seven(pose).inverse().seven() for pose in poses])
    for reading, signs in (
        (Reading.X_OPPOSITE, (-1, 1, 1)),
        (Reading.Y_OPPOSITE, (1, -1, 1)),
        (Reading.Z_OPPOSITE, (1, 1, -1)),
        (Reading.ALL_OPPOSITE, (-1, -1, -1)),
    ):
        yield reading, np.hstack((at * signs, turned))
    yield Reading.SWAPPED, np.hstack((at[:, [1, 0, 2]], turned))
    yield Reading.ROW_BEFORE, np.vstack((poses[1:], poses[-1:]))
    yield Reading.ROW_AFTER, np.vstack((poses[:1], poses[:-1]))


def _unit_of_spread(spread_mm: float, size_mm: float) -> UnitName:
    """Metres, or what brings a spread nearer to the sensor's size."""
    return min(
        (UnitName.M, UnitName.CM),
        key=lambda unit: abs(math.log(spread_mm * LENGTHS[unit] / (2 * size_mm))),
    )


def _apart_mm(poses: F64) -> float:
    """The median distance from a press to the nearest other one, of some."""
    at = poses[:: -(-len(poses) // 256), :3]
    far = np.linalg.norm(at[:, None] - at[None], axis=2)
    np.fill_diagonal(far, np.inf)
    return float(np.median(far.min(axis=1)))
