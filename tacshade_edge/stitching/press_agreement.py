"""How well presses agree on one surface at given poses, and what that says of a table of poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.plausibility.pose_tables import PressAgreement, judge_poses
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.stitching.refinement import CELL_MM, LATERAL_RATIO, overlap_cells
from tacshade_edge.types import F64, I64

# Of one point: a press that another reading throws far off must not count for all others.
_DIFFERENCE_MAX_MM = 3.0
_LEAST_OTHERS = 0.05
# On a nominal skin; on a larger one, as many thinned points stand farther apart.
_CELL_MM, _NOMINAL_MM = 1.5 * CELL_MM, 20.0
# Cells are numbered; farther apart, nothing overlaps anyway.
_SPREAD_MAX_MM = 1e5


def press_agreement(
    presses: Sequence[F64], base_T_sensor: Sequence[Rigid], size_mm: float
) -> PressAgreement:
    """Measure the agreement of presses (`refinement.thin_points`) of a sensor of this size."""
    at = np.concatenate(
        [pose.apply(press[:, :3]) for press, pose in zip(presses, base_T_sensor, strict=True)]
    )
    weight = np.concatenate([press[:, 3] for press in presses])
    press_of = np.repeat(np.arange(len(presses)), [len(press) for press in presses])
    # Presses that read in µm stand kilometres apart.
    at[:, :2] -= np.median(at[:, :2], axis=0)
    inside = (np.abs(at[:, :2]) < _SPREAD_MAX_MM).all(axis=1)
    if not inside.any():
        return PressAgreement(np.nan, 0.0)
    at, weight, press_of = at[inside], weight[inside], press_of[inside]
    cells = overlap_cells(at, weight, _CELL_MM * max(1.0, size_mm / _NOMINAL_MM))
    cell = cells.of_point
    mean = np.bincount(cell, weight * cells.height_mm) / np.bincount(cell, weight)
    pair = cell * len(presses) + press_of
    # The weight of each point's own press in its cell, whose mean follows the press by that part.
    used, pair = np.unique(pair, return_inverse=True)
    own_part = np.bincount(pair, weight)[pair] / np.bincount(cell, weight)[cell]
    shared = np.bincount(used // len(presses), minlength=cells.count)[cell] > 1
    if not shared.any():
        return PressAgreement(np.nan, 0.0)
    trust = weight / (1 + LATERAL_RATIO**2 * np.sum(cells.slope**2, axis=1))
    off_mm = np.minimum(np.abs(cells.height_mm - mean[cell])[shared], _DIFFERENCE_MAX_MM)
    off_mm /= np.sqrt(np.maximum(1 - own_part[shared], _LEAST_OTHERS))
    rms_mm = float(np.sqrt(np.average(off_mm**2, weights=trust[shared])))
    return PressAgreement(rms_mm, float(weight[shared].sum() / weight.sum()))


def suspected_poses(
    presses: Sequence[F64],
    base_T_flange: Sequence[Rigid],
    flange_T_sensor: Rigid,
    size_mm: float,
    *,
    flange_known: bool = True,
) -> Suspicion | None:
    """What is wrong with the poses of presses (`refinement.thin_points`), in their order; None if
    nothing is. `size_mm` is the sensor's.
    """
    if not presses:
        return None

    def agree(numbers: I64, poses: F64) -> PressAgreement:
        placed = [from_seven(pose.tolist()) @ flange_T_sensor for pose in poses]
        return press_agreement([presses[k] for k in numbers.tolist()], placed, size_mm)

    table = np.array([pose.seven() for pose in base_T_flange])
    return judge_poses(table, size_mm, agree, flange_known=flange_known)
