"""Track the numbers of poses: how many are missing, which are repeated."""

from __future__ import annotations

from typing import Final

from tacshade_edge.protocol.serial.line import SEQ_MODULO

POSES_BEHIND: Final = 64  # a pose up to this far behind is a repeat; an older number restarts the count


class PoseSequence:
    """Tracks pose numbers modulo 65536."""

    def __init__(self) -> None:
        self._newest: int | None = None

    def missing_before(self, seq: int | None) -> int | None:
        """The number of poses missing between this pose and the previous one; None for a repeated pose.

        A pose without a number (None) follows the previous one.
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
