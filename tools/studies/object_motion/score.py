"""Run the tracker on a trial and compare the result with the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from tacshade_edge.core.hand.object_motion import ObjectMotion, ObjectTracker
from tacshade_edge.rigid import Rigid, turned_rad
from tacshade_edge.types import F64
from tools.studies.object_motion.trial import Trial

CHI2_90: Final = (0.0, 2.706, 4.605, 6.251, 7.779, 9.236, 10.645)
"""90 % quantiles of the chi-squared distribution, by degrees of freedom."""
LEVER_MM: Final = 20.0
ALIKE: Final = 0.2
"""Directions of motion within this sine of an angle count as equal; `LEVER_MM` converts rotations to lengths."""


@dataclass(frozen=True, slots=True)
class MotionRow:
    """The result of a trial; each attribute is a column of object_motion.csv.

    Attributes
    ----------
    object, skin, event : str
    fingers : int
    patch_mm, turned_deg : float
        At the end, true motion of the point that moved furthest, and true rotation of the object.
    translation_off_mm, rotation_off_deg : float
        Errors at the end, of the object's middle and of its rotation.
    ellipsoid : float
        Squared error at the end, weighted by the inverse covariance, over the bound of the 90 % ellipsoid.
    jump_mm : float
        Greatest change of a point's error from one moment to the next.
    hidden : int
        Number of directions that the geometry left unobserved at some moment.
    named : bool
        Whether the tracker reports as many lines, all of them among these directions.
    step_ms : float
        Mean time of a step on one core.
    """

    object: str
    skin: str
    event: str
    fingers: int
    patch_mm: float
    turned_deg: float
    translation_off_mm: float
    rotation_off_deg: float
    ellipsoid: float
    jump_mm: float
    hidden: int
    named: bool
    step_ms: float


def score(trial: Trial) -> MotionRow:
    """Run the tracker on a trial and score it."""
    tracker = ObjectTracker()
    jump_mm, spent_s, count = 0.0, 0.0, 0
    before: F64 | None = None
    stuck: set[frozenset[str]] = set()
    places: dict[str, tuple[float, float, float]] = {}
    for moment in trial.moments:
        began_s = time.perf_counter()
        found = tracker.step(moment.t_ns, moment.patches)
        spent_s += time.perf_counter() - began_s
        count += 1
        assert found is not None
        stuck.add(frozenset(key for key, patch in moment.patches.items() if not patch.slips))
        places |= {key: patch.place_mm for key, patch in moment.patches.items()}
        error_mm = found.rigid().apply(trial.points_mm) - moment.moved.apply(trial.points_mm)
        if before is not None:
            jump_mm = max(jump_mm, float(np.linalg.norm(error_mm - before, axis=1).max()))
        before = error_mm
    assert before is not None
    assert found is not None
    middle_mm = trial.points_mm[0]
    hidden = _independent(np.vstack([_unseen(np.array([places[key] for key in keys]) - middle_mm) for keys in stuck]))
    left = found.rigid().rotation @ moment.moved.rotation.T
    way_mm = moment.moved.apply(trial.points_mm) - trial.points_mm
    return MotionRow(
        *(trial.object, trial.skin, trial.event, trial.fingers),
        *(float(np.linalg.norm(way_mm, axis=1).max()), _degrees(moment.moved.rotation)),
        *(float(np.linalg.norm(before[0])), _degrees(left), _ellipsoid(found, moment.moved), jump_mm),
        len(hidden),
        _names(found, hidden, middle_mm),
        1000 * spent_s / count,
    )


def _unseen(arms_mm: F64) -> F64:
    """Find the directions (k, 6) of motions that leave all these places where they are."""
    rows = []
    for x, y, z in arms_mm / LEVER_MM:
        rows.append(np.hstack((np.eye(3), ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))))
    _, sizes, directions = np.linalg.svd(np.vstack(rows))
    return np.asarray(directions[np.count_nonzero(sizes > 1e-6) :])


def _independent(directions: F64) -> F64:
    """Find orthogonal directions that span all given directions that differ."""
    _, sizes, alone = np.linalg.svd(directions, full_matrices=False)
    return np.asarray(alone[sizes > ALIKE])


def _names(found: ObjectMotion, hidden: F64, middle_mm: F64) -> bool:
    """Whether the reported lines are all among the hidden directions, and equal in number."""
    for line in found.unobserved:
        if line.through_mm is None:
            return False
        axis = np.array(line.axis)
        direction = np.hstack((np.cross(axis, middle_mm - line.through_mm), LEVER_MM * axis))
        direction /= np.linalg.norm(direction)
        if np.linalg.norm(direction - (direction @ hidden.T) @ hidden) > ALIKE:
            return False
    return len(found.unobserved) == len(hidden)


def _degrees(rotation: F64) -> float:
    return float(np.degrees(np.linalg.norm(turned_rad(rotation))))


def _ellipsoid(found: ObjectMotion, truth: Rigid) -> float:
    """Compute the squared error, weighted by the inverse covariance, over its 90 % bound in the observed directions."""
    off_mm = found.about_mm + found.translation_mm - truth.apply(found.about_mm)
    error = np.append(off_mm, turned_rad(found.rigid().rotation @ truth.rotation.T))
    return float(error @ np.linalg.solve(found.covariance, error)) / CHI2_90[max(1, 6 - len(found.unobserved))]
