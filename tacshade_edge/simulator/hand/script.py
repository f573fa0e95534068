"""The motion of a held object and of the fingers over time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.rigid import Rigid, turn, turned_rad
from tacshade_edge.simulator.hand.held import Placement


@dataclass(frozen=True, slots=True, eq=False)
class HandScript:
    """Knots of the path of an object and of the fingers at increasing times; all moves straight and steadily between
    two knots, and rests before the first and after the last.
    """

    times_s: tuple[float, ...]
    placements: tuple[Placement, ...]

    def __post_init__(self) -> None:
        """Raise ValueError for times that do not increase or do not match the placements."""
        if len(self.times_s) != len(self.placements) or not self.times_s:
            raise ValueError(f"{len(self.times_s)} times for {len(self.placements)} placements, expected as many")
        if not all(np.diff(self.times_s) > 0) or not math.isfinite(self.times_s[-1] - self.times_s[0]):
            raise ValueError(f"times_s is {self.times_s}, expected increasing numbers")

    def held(self, for_s: float) -> HandScript:
        """Append a rest."""
        return self._then(for_s, self.placements[-1])

    def fingers_back(self, back_mm: Sequence[float], for_s: float) -> HandScript:
        """Append a motion of the fingers to the retraction `back_mm`."""
        return self._then(for_s, replace(self.placements[-1], back_mm=tuple(back_mm)))

    def moved(self, hand_T_object: Rigid, for_s: float) -> HandScript:
        """Append a motion of the object to a pose."""
        return self._then(for_s, replace(self.placements[-1], hand_T_object=hand_T_object))

    def at(self, t_s: float) -> Placement:
        """The placement at a time; the same value while everything rests."""
        k = bisect_right(self.times_s, t_s)
        one, other = self.placements[max(k - 1, 0)], self.placements[min(k, len(self.placements) - 1)]
        if one is other:
            return one
        part = (t_s - self.times_s[k - 1]) / (self.times_s[k] - self.times_s[k - 1])
        a, b = one.hand_T_object, other.hand_T_object
        rotation = a.rotation @ turn(part * turned_rad(a.rotation.T @ b.rotation)).rotation
        pose = Rigid(rotation, a.translation_mm + part * (b.translation_mm - a.translation_mm))
        return Placement(pose, tuple(p + part * (q - p) for p, q in zip(one.back_mm, other.back_mm, strict=True)))

    def _then(self, for_s: float, placement: Placement) -> HandScript:
        return HandScript((*self.times_s, self.times_s[-1] + for_s), (*self.placements, placement))
