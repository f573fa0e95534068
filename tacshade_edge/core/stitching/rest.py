"""When a robot that presses has come to rest: once for each contact."""

from __future__ import annotations

SETTLE_NS = 300_000_000
STEADY_MM = 0.06
_STEADY_PART = 0.03  # a deep contact's depth trembles more


class Settled:
    """Told of every frame; says once in each contact that its depth has been steady for `SETTLE_NS`."""

    def __init__(self) -> None:
        self._told = False
        self._since_ns = 0
        self._low = self._high = 0.0

    def taken(self) -> None:
        """The present contact counts already: something else has said so."""
        self._told = True

    def of(self, t_ns: int, contact: bool, depth_mm: float) -> bool:
        """Whether the contact has just settled.

        Parameters
        ----------
        t_ns : int
            Of the frame.
        contact : bool
            A valid frame in contact; any other ends the contact.
        depth_mm : float
            Greatest depth.
        """
        if not contact:
            self._told, self._since_ns = False, 0
            return False
        low, high = min(self._low, depth_mm), max(self._high, depth_mm)
        if self._since_ns == 0 or high - low > STEADY_MM + _STEADY_PART * high:
            self._since_ns, self._low, self._high = t_ns, depth_mm, depth_mm
            return False
        self._low, self._high = low, high
        if self._told or t_ns - self._since_ns < SETTLE_NS:
            return False
        self._told = True
        return True
