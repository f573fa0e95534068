"""Many presses, one map: what was touched, brought to the base frame by the robot's poses.

Poses are as good as the robot. How good is seen from the map itself: where the presses would have to move by no more
than the reconstruction's own error to agree, they are taken as exact, else as found by `stitch_refine`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.stitching.press_points import Touch, height_weight
from tacshade_edge.core.stitching.refinement import PoseError, correction, refined, thinned
from tacshade_edge.core.stitching.surface_map import LEAST_WEIGHT, STEP_MM, Raster, TouchMap
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F32, F64

MAX_POINTS = 4_000_000
"""Of all presses together: 16 bytes each, 64 MB."""
EXACT_MM = 0.12
"""RMS by which presses with exact poses are moved in height at most (0.07 on the simulated pad)."""
# Where poses are not exact, an outline is where some press is off: there it takes more of a touch.
_LEAST_UNSURE = 0.15
_FUSE_ROBUST_MM = 0.2  # a point that far from its cell's mean counts half
# A press that is off its neighbours by so much after refinement, or was moved by so many standard deviations, is none.
REJECT_MM = 0.6
REJECT_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class Placed:
    """One press in a finished map.

    Attributes
    ----------
    base_T_sensor : Rigid
        As found, or as reported where poses are exact.
    moved_mm, turned_deg : float
        How far from the reported pose, at the apex.
    rejected : str
        Empty, or why its points are not in the map.
    """

    base_T_sensor: Rigid
    moved_mm: float
    turned_deg: float
    rejected: str


@dataclass(frozen=True, slots=True)
class Stitched:
    """A finished map.

    Attributes
    ----------
    raster : Raster
    presses : tuple of Placed
    disagreement_mm : float
        RMS of how far presses would have to move in height to agree; 0 where it was not asked for.
    refined : bool
        The poses were not taken as exact.
    """

    raster: Raster
    presses: tuple[Placed, ...]
    disagreement_mm: float
    refined: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Press:
    """What is kept of one: points in the sensor frame, their weights in height, and the few that refine its pose."""

    points_mm: F32
    weight: F32
    thin: F64
    reported: Rigid

    def at(self, base_T_sensor: Rigid) -> F64:
        return base_T_sensor.apply(self.points_mm)


class Stitcher:
    """Collects presses; the map of those so far is there at any time, the refined one at the end.

    Parameters
    ----------
    apex_mm : float
        The skin's radius: z of the undeformed apex in the sensor frame.
    step_mm : float
        Of the map.
    """

    def __init__(self, apex_mm: float, step_mm: float = STEP_MM) -> None:
        self._apex = np.array((0.0, 0.0, apex_mm))
        self._step_mm = step_mm
        self._presses: list[_Press] = []
        self._points = 0
        self.map = TouchMap(step_mm)

    @property
    def presses(self) -> int:
        """How many there are."""
        return len(self._presses)

    @property
    def points(self) -> int:
        """How many points they have."""
        return self._points

    def add(self, touch: Touch, base_T_sensor: Rigid) -> None:
        """Add a press as reported; its cost does not grow with the map.

        Raises
        ------
        ValueError
            Nothing was touched, or the map is full (`MAX_POINTS`, `touch_map.MAX_TILES`); nothing was added.
        """
        count = len(touch.points_mm)
        if count == 0:
            raise ValueError("nothing was touched")
        if self._points + count > MAX_POINTS:
            raise ValueError(f"the map would get more than {MAX_POINTS} points")
        # A refined pose is turned by a degree or so: that does not change what is steep.
        weight = height_weight(touch, base_T_sensor)
        press = _Press(touch.points_mm, weight.astype(np.float32), thinned(touch), base_T_sensor)
        self.map.add(press.at(base_T_sensor), press.weight)
        self._presses.append(press)
        self._points += count

    def finish(self, error: PoseError | None = PoseError()) -> Stitched:  # noqa: B008 (frozen)
        """Find the poses, leave out presses that fit nowhere, fuse again without outlying points.

        Parameters
        ----------
        error : PoseError or None
            What the robot's poses are off by if they are not exact; None takes them as exact.
        """
        poses, disagreement_mm = [p.reported for p in self._presses], 0.0
        found = list(poses)
        if error is not None and self.presses > 1:
            found = refined([p.thin for p in self._presses], poses, self._apex, error)
            up = [(f.apply(self._apex) - p.apply(self._apex))[2] for f, p in zip(found, poses, strict=True)]
            disagreement_mm = float(np.sqrt(np.mean(np.square(up))))
        exact = disagreement_mm <= EXACT_MM
        if exact:
            found, error = poses, None
        fused = self._fused(found, [""] * len(found), None)
        placed = [self._placed(press, pose, fused, error) for press, pose in zip(self._presses, found, strict=True)]
        rejected = [p.rejected for p in placed]
        if any(rejected):
            fused = self._fused(found, rejected, None)
        fused = self._fused(found, rejected, fused)
        raster = fused.raster(LEAST_WEIGHT if exact else _LEAST_UNSURE)
        return Stitched(raster, tuple(placed), disagreement_mm, not exact)

    def _placed(self, press: _Press, pose: Rigid, fused: TouchMap, error: PoseError | None) -> Placed:
        at = pose.apply(press.thin[:, :3])
        off_mm = float(np.median(np.abs(at[:, 2] - fused.z_at(at))))
        moved_mm, turned_deg = correction(press.reported, pose, self._apex)
        rejected = ""
        if off_mm > REJECT_MM:
            rejected = f"{off_mm:.2f} mm off the other presses"
        elif error is not None and moved_mm > REJECT_SIGMAS * error.position_mm:
            rejected = f"would have to move by {moved_mm:.2f} mm"
        elif error is not None and turned_deg > REJECT_SIGMAS * error.rotation_deg:
            rejected = f"would have to turn by {turned_deg:.1f} degrees"
        return Placed(pose, moved_mm, turned_deg, rejected)

    def _fused(self, poses: Sequence[Rigid], rejected: Sequence[str], before: TouchMap | None) -> TouchMap:
        """The presses in a new map; a point counts less, the farther it is from a map that was fused before."""
        fused = TouchMap(self._step_mm, bounded=False)  # refined, presses lie a little elsewhere
        for press, pose, out in zip(self._presses, poses, rejected, strict=True):
            if out:
                continue
            at, weight = press.at(pose), press.weight
            if before is not None:
                weight = np.nan_to_num(weight / (1 + ((at[:, 2] - before.z_at(at)) / _FUSE_ROBUST_MM) ** 2))
            fused.add(at, weight)
        return fused
