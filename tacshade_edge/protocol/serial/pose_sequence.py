"""The numbers of poses: how many are missing, which came again."""

from __future__ import annotations

from typing import Final

from tacshade_edge.protocol.serial.line import SEQ_MODULO

POSES_BEHIND: Final = 64  # a pose with so old a number comes again; one with an older begins to count anew


class PoseSequence:
    """Counts modulo 65536."""

    def __init__(self) -> None:
        self._newest: int | None = None

    def missing_before(self, seq: int | None) -> int | None:
        """How many are missing between this pose and the one before; None for one that came again.

        A pose without a number (None) follows the one before.
        """
        if seq is None:
            return 0
        missing = 0
        if self._newest is not None:
            ahead = (seq - self._newest) % SEQ_MODULO
            if -ahead % SEQ_MODULO < POSES_BEHIND:
                return None
            missing = ahead - 1 if ahead < SEQ_MODULO // 2 else 0
        self._newest = seq
        return missing
