"""The motion of an object over time: it comes down, is held, dragged, twisted, and lifted off."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, fields, replace

import numpy as np

from tacshade_edge.simulator.press import Press

CLEAR_MM = 1.0
"""Height above the skin at which a motion begins and ends."""

_SPAN_S = 1e-4
_LEVER_MM = 5.0  # converts a turn to a motion
_NUMBERS = tuple(field.name for field in fields(Press) if field.name != "shape")


@dataclass(frozen=True, slots=True)
class Motion:
    """The knots of an object's path, which is linear between two knots; before and after, the object is absent.

    Presses are of one shape; `depth_mm` is the immediate depth under the load: into a creeping skin, it sinks further.
    """

    times_s: tuple[float, ...]
    presses: tuple[Press, ...]

    def __post_init__(self) -> None:
        """Refuse times that do not increase, and an object whose shape changes."""
        if len(self.times_s) != len(self.presses) or len(self.times_s) < 2:
            raise ValueError(f"{len(self.times_s)} times for {len(self.presses)} presses, expected two or more of each")
        if not all(np.diff(self.times_s) > 0) or not math.isfinite(self.times_s[-1] - self.times_s[0]):
            raise ValueError(f"times_s is {self.times_s}, expected increasing numbers")
        if any(press.shape is not self.presses[0].shape for press in self.presses):
            raise ValueError("presses of several shapes, expected one object")

    def held(self, for_s: float) -> Motion:
        """Add a time in which the object stays."""
        return self._then(for_s, self.presses[-1])

    def dragged(self, x_mm: float, y_mm: float, speed_mm_s: float) -> Motion:
        """Add a drag along the skin."""
        last = self.presses[-1]
        moved = replace(
            last,
            x_mm=last.x_mm + x_mm,
            y_mm=last.y_mm + y_mm,
            drag_x_mm=last.drag_x_mm + x_mm,
            drag_y_mm=last.drag_y_mm + y_mm,
        )
        return self._then(math.hypot(x_mm, y_mm) / speed_mm_s, moved)

    def twisted(self, angle_deg: float, speed_deg_s: float) -> Motion:
        """Add a turn about z, from x towards y."""
        last = self.presses[-1]
        turned = replace(last, rotation_deg=last.rotation_deg + angle_deg, twist_deg=last.twist_deg + angle_deg)
        return self._then(abs(angle_deg) / speed_deg_s, turned)

    def released(self, speed_mm_s: float) -> Motion:
        """Add a release along z."""
        last = self.presses[-1]
        up = self._then(last.depth_mm / speed_mm_s, replace(last, depth_mm=0.0))
        return up._then(CLEAR_MM / speed_mm_s, replace(last, depth_mm=-CLEAR_MM))

    def at(self, t_s: float) -> Press | None:
        """Compute the press at a time; None while the object is absent."""
        if not self.times_s[0] <= t_s <= self.times_s[-1]:
            return None
        k = min(bisect_right(self.times_s, t_s), len(self.times_s) - 1) - 1
        one, other = self.presses[k : k + 2]
        part = (t_s - self.times_s[k]) / (self.times_s[k + 1] - self.times_s[k])
        between = {
            name: a + part * (b - a) for name in _NUMBERS if (a := getattr(one, name)) != (b := getattr(other, name))
        }
        return replace(one, **between) if between else one

    def velocity(self, t_s: float, skin_radius_mm: float) -> tuple[tuple[float, float, float], float]:
        """Compute the lowest point's velocity without creep, in mm/s along x, y, z, and the turn about z in deg/s."""
        early, late = max(t_s - _SPAN_S, self.times_s[0]), min(t_s + _SPAN_S, self.times_s[-1])
        one, other = self.at(early), self.at(late)
        if early >= late or one is None or other is None:
            return (0.0, 0.0, 0.0), 0.0
        per_s = 1 / (late - early)
        up = other.lowest_z_mm(skin_radius_mm) - one.lowest_z_mm(skin_radius_mm)
        along = (other.x_mm - one.x_mm) * per_s, (other.y_mm - one.y_mm) * per_s
        return (*along, up * per_s), (other.rotation_deg - one.rotation_deg) * per_s

    def steps_s(self, step_mm: float) -> tuple[float, ...]:
        """List the knots' times, and times in between so that the object moves by at most a step between two times."""
        times = [self.times_s[0]]
        for k, (one, other) in enumerate(zip(self.presses[:-1], self.presses[1:], strict=True)):
            along = math.hypot(other.x_mm - one.x_mm, other.y_mm - one.y_mm, other.depth_mm - one.depth_mm)
            turned = math.radians(abs(other.rotation_deg - one.rotation_deg)) * _LEVER_MM
            parts = max(1, math.ceil((along + turned) / step_mm))
            times.extend(np.linspace(self.times_s[k], self.times_s[k + 1], parts + 1)[1:].tolist())
        return tuple(times)

    def _then(self, for_s: float, press: Press) -> Motion:
        return Motion((*self.times_s, self.times_s[-1] + for_s), (*self.presses, press))


def pressed(press: Press, start_s: float, speed_mm_s: float) -> Motion:
    """Make a motion in which an object comes down along z from above the skin to a press."""
    touches_s = start_s + CLEAR_MM / speed_mm_s
    return Motion(
        (start_s, touches_s, touches_s + press.depth_mm / speed_mm_s),
        (replace(press, depth_mm=-CLEAR_MM), replace(press, depth_mm=0.0), press),
    )
