"""Contact of a linear elastic skin with a rigid object that moves, with Coulomb friction.

The skin answers to forces at its points through a compliance matrix. At every step of the object's
motion, the forces are relaxed point by point until no point lies inside the object, none is pulled,
and each point of contact either moves with the object or slides under the greatest friction
(projected Gauss-Seidel).
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.types import F64
from tools.studies.strangers.motion import Pose, clearance_mm, moves

STEP_MM = 0.3
"""Greatest motion of the object in a step."""
LINEARISED = 4
"""How often the object's surface is replaced by planes in a step."""
SWEEPS, TOLERANCE_MM = 150, 2e-4
NEAR_MM = 1.5
"""Points farther than this from the object cannot touch it in a step."""


def solved(
    rest_mm: F64, compliance: F64, friction: float, radius_mm: float, stops: Sequence[Press]
) -> list[F64]:
    """Move an object down and through its stops.

    `rest_mm` (N, 3): the points that may touch it. `compliance` (3 N, 3 N): their motion under unit
    forces. Returns the forces (N, 3) at each stop.
    """
    forces, moved = np.zeros_like(rest_mm), np.zeros_like(rest_mm)
    made = []
    lifted_mm = clearance_mm(rest_mm, radius_mm, stops[0])
    for to_stop in moves(radius_mm, stops, lifted_mm, STEP_MM):
        for pose, by in to_stop:
            forces, moved = _stepped(rest_mm, compliance, friction, pose, (forces, moved, by))
        made.append(forces)
    return made


def _stepped(
    rest_mm: F64, compliance: F64, friction: float, pose: Pose, before: tuple[F64, F64, F64]
) -> tuple[F64, F64]:
    forces, moved, by = before[0].copy(), before[1], before[2]
    now = moved.copy()
    near = (pose.distance_mm(rest_mm + now) < NEAR_MM) | (np.abs(forces).sum(axis=1) > 0)
    index = np.flatnonzero(near)
    degrees = (3 * index[:, None] + np.arange(3)).ravel()
    own = np.ascontiguousarray(compliance[np.ix_(degrees, degrees)])
    for _ in range(LINEARISED):
        points = rest_mm[index] + now[index]
        gap, normal = pose.distance_mm(points), pose.normals(points)
        slip = now[index] - moved[index] - by
        force = forces[index]
        change = _relaxed(own, normal, gap, slip, force, friction, SWEEPS, TOLERANCE_MM)
        forces[index] = force
        now[index] += change.reshape(-1, 3)
    return forces, (compliance @ forces.ravel()).reshape(-1, 3)


@numba.njit(cache=True)
def _relaxed(
    compliance: F64,
    normal: F64,
    gap: F64,
    slip: F64,
    force: F64,
    friction: float,
    sweeps: int,
    tolerance_mm: float,
) -> F64:
    """Relax the forces (n, 3) in place; return the change of the places (n, 3)."""
    count = len(gap)
    change = np.zeros(3 * count)
    for _ in range(sweeps):
        greatest = 0.0
        for i in range(count):
            k = 3 * i
            soft = (compliance[k, k] + compliance[k + 1, k + 1] + compliance[k + 2, k + 2]) / 3
            n = normal[i]
            inside = gap[i] + n[0] * change[k] + n[1] * change[k + 1] + n[2] * change[k + 2]
            old = force[i, 0] * n[0] + force[i, 1] * n[1] + force[i, 2] * n[2]
            pushed = max(0.0, old - inside / soft)
            tangent = np.empty(3)
            along = 0.0
            for c in range(3):
                along += n[c] * (slip[i, c] + change[k + c])
            size = 0.0
            for c in range(3):
                moves = slip[i, c] + change[k + c] - along * n[c]
                tangent[c] = force[i, c] - old * n[c] - moves / soft
                size += tangent[c] * tangent[c]
            size = np.sqrt(size)
            held = 1.0 if size <= friction * pushed else friction * pushed / size
            for c in range(3):
                by = pushed * n[c] + held * tangent[c] - force[i, c]
                if by != 0.0:
                    force[i, c] += by
                    for row in range(3 * count):
                        change[row] += compliance[row, k + c] * by
                    greatest = max(greatest, abs(by) * soft)
        if greatest < tolerance_mm:
            break
    return change
