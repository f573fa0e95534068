"""Judge a frame beside its map: a touch that it does not show, a contact that is a moving tip."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.motion import MOVED_ERROR, WhiteChange
from tacshade_edge.sensor.contact.rest import Evidence
from tacshade_edge.sensor.depth.solver import Depth
from tacshade_edge.types import F32, Bool, RestLimits

MOVING_PART, MOVED_RADII, LOCAL = 0.4, 0.025, 0.02
"""A tip moves if a shift and turn of the whole pattern explain this part of the change, go this
far, and leave no greater local change, in shares of white (a rest shows a limit of its own). Real
tips that sway show up to 0.9, 0.03 to 0.04 and at most 0.01; presses of a real dome are explained
up to 0.3, simulated ones up to 0.12, dragged ones too; those of a real pad that are explained so
far move the pattern less, or leave more.
"""
PRESSED_PART = 0.03
"""Part of the disc that a touch presses at least: a patch of 3 mm radius on a skin of 20 mm."""
FAINT_GLARE = 6.0
"""Levels by which light lifts the darkest pixels of a place, unless more of the picture changed
than a spot covers. Rest, drift and presses reach 4, simulated and real, faint glare 7 to 30, but
for spots of a few pixels.
"""
DENT_PART, DENT_S = 0.15, 3.0
"""A soft skin keeps 2 to 10 % of a press for a few seconds: after a contact, only heights above
this part of its depth are a touch for that time.
"""


class TouchDetector:
    """Judges the frames of one sensor and profile, in their order. `inside` is the disc on the
    map's cells; without `limits`, no touch is found that the map does not show.
    """

    def __init__(self, change: WhiteChange, inside: Bool, limits: RestLimits | None) -> None:
        self._limits = limits
        self._change = change
        self._disc, self._inside = inside, np.flatnonzero(inside)
        self._pressed = math.ceil(PRESSED_PART * len(self._inside))
        self._contact_ns: int | None = None  # of the latest contact, and how deep it went
        self._contact_mm = 0.0

    def evidence(self, depth: Depth, white: F32, changed_part: float) -> Evidence:
        """What speaks for a touch, from the network's heights, the frame's white and the part of
        the picture that changed.
        """
        return Evidence(self._height_mm(depth), self._change.local(white), changed_part)

    def contact(self, t_ns: int, depth_mm: float) -> None:
        """Note a contact, which may leave a dent."""
        # The dent of several presses in short order is that of the deepest.
        if self.relaxed(t_ns):
            self._contact_mm = 0.0
        self._contact_ns = t_ns
        self._contact_mm = max(self._contact_mm, depth_mm)

    def relaxed(self, t_ns: int) -> bool:
        """Whether the skin has left no dent; frames of one time are no sequence."""
        last_ns = self._contact_ns
        # Times that stand still or go back are single pictures or another recording.
        return last_ns is None or not 0 < t_ns - last_ns <= DENT_S * 1e9

    def moving(self, depth: Depth, white: Callable[[], F32]) -> Reason | None:
        """Why a contact is only a motion of the tip;
        None if it is a contact, as whatever goes beyond the rest.
        """
        # Limits add touches and take no contact away (docs/decisions/0015-rest.md): of a contact
        # that goes beyond the rest, a motion of the whole pattern is no excuse.
        if self._limits is not None and self._is_higher(depth, self._limits.height_mm):
            return None
        return self._motion(white())

    def felt(
        self,
        t_ns: int,
        depth: Depth,
        white: F32,
        changed_part: float,
        lift: Callable[[], float] = lambda: 0.0,
    ) -> Reason | None:
        """Why a frame without a contact in its map is no untouched one; None if it is. `lift` gives
        `GlareFinder.lift`.
        """
        limits = self._limits
        if limits is None:
            return None
        local_change, height_mm = self._change.local(white), self._height_mm(depth)
        relaxed = self.relaxed(t_ns)
        # A dent changes the white and the picture as a touch does; only its height is known to be
        # less than the press's.
        dent_mm = 0.0 if relaxed else DENT_PART * self._contact_mm
        found = []
        if height_mm > max(limits.height_mm, dent_mm):
            found.append(
                f"the network finds {height_mm:.3f} mm, at rest at most {limits.height_mm:.3f}"
            )
        if relaxed and local_change > limits.local_change:
            most = f"{100 * limits.local_change:.1f}"
            found.append(
                f"the white changed by {100 * local_change:.1f} % in a place, at most {most}"
            )
        if relaxed and changed_part > limits.changed_part:
            found.append(f"{100 * changed_part:.0f} % of the picture changed")
        if not found:
            return None
        # Asked last, as it searches the whole picture; a picture that changed beyond the rest is no
        # spot of glare.
        levels = lift() if changed_part <= limits.changed_part else 0.0
        if levels >= FAINT_GLARE:
            text = f"faint glare: light lifts the darkest pixels of a place by {levels:.0f} levels"
            return Reason(ReasonCode.GLARE, text)
        text = "something touches, but its depth is unknown"
        touch = Reason(ReasonCode.TOUCH_UNMEASURED, f"{text}: {'; '.join(found)}")
        return self._motion(white) or touch

    def _motion(self, white: F32) -> Reason | None:
        """How the tip moves; None if it does not, or if the motion leaves a local change."""
        # A sensor's own rest shows what a sway leaves, beyond what those of other sensors did.
        most = LOCAL if self._limits is None else self._limits.local_change
        # Few contacts move the pattern so far, and this is every other.
        if self._change.moved_radii(white) < MOVED_RADII - MOVED_ERROR:
            return None
        motion = self._change.motion(white)
        far = motion.explained >= MOVING_PART and motion.moved_radii >= MOVED_RADII
        if not far or self._change.local(white) > most:
            return None
        moved = f"{100 * motion.moved_radii:.0f} % of the disc's radius"
        explained = f"{100 * motion.explained:.0f} % of the change"
        return Reason(
            ReasonCode.TIP_MOVING, f"the tip moves by {moved}, which explains {explained}"
        )

    def _is_higher(self, depth: Depth, limit_mm: float) -> bool:
        """Whether `_height_mm` is above the limit."""
        # So many cells above it are enough, which is faster than to find the highest; their mean is
        # rounded by less than this margin.
        above: Bool = depth.height_mm > np.float32(1.001 * limit_mm + 1e-6)
        above &= self._disc
        if int(np.count_nonzero(above)) >= max(self._pressed, 1):
            return True
        return self._height_mm(depth) > limit_mm

    def _height_mm(self, depth: Depth) -> float:
        """The mean height of the most pressed part of the disc."""
        heights = depth.height_mm.take(self._inside)
        if not heights.size:
            return 0.0
        # A patch's mean: the greatest of many cells varies so much at rest that a limit for one
        # frame in 10,000 would lie above most touches (docs/decisions/0015-rest.md).
        heights.partition(heights.size - self._pressed)
        return float(heights[-self._pressed :].mean())
