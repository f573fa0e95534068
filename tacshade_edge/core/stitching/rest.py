"""Detect when a pressing robot has come to rest, once for each contact."""

from __future__ import annotations

REST_NS = 300_000_000
STEADY_MM = 0.06
_STEADY_FRACTION = 0.03  # of the depth, because a deep contact trembles more


class RestDetector:
    """Fires once in each contact, after its depth was steady for `REST_NS`."""

    def __init__(self) -> None:
        self._fired = False
        self._since_ns = 0
        self._min_mm = self._max_mm = 0.0

    def suppress(self) -> None:
        """Count the present contact as fired, so that it does not fire again."""
        self._fired = True

    def update(self, t_ns: int, contact: bool, depth_mm: float) -> bool:
        """Take the next frame (an invalid one counts as without contact, which ends it), and return whether the contact
        has just come to rest.
        """
        if not contact:
            self._fired, self._since_ns = False, 0
            return False
        min_mm, max_mm = min(self._min_mm, depth_mm), max(self._max_mm, depth_mm)
        if self._since_ns == 0 or max_mm - min_mm > STEADY_MM + _STEADY_FRACTION * max_mm:
            self._since_ns, self._min_mm, self._max_mm = t_ns, depth_mm, depth_mm
            return False
        self._min_mm, self._max_mm = min_mm, max_mm
        if self._fired or t_ns - self._since_ns < REST_NS:
            return False
        self._fired = True
        return True
