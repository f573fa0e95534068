"""What came in on the robot's line, counted."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(slots=True)
class LinkCounts:
    """What came in, since the start. Every numbered pose between two that arrived is in `poses` or `poses_lost`."""

    bytes: int = 0
    lines: int = 0
    commands: int = 0  # handed out, each once
    repeats: int = 0  # answered from the cache, or still being done
    refused: int = 0  # answered with ERR before they were handed out
    echoes: int = 0  # our own lines come back
    poses: int = 0
    poses_lost: int = 0  # by their numbers
    poses_repeated: int = 0
    poses_bad: int = 0  # undamaged, and no pose
    damaged: int = 0  # lines and frames with a wrong checksum
    garbage: int = 0  # stretches of bytes that are no line and no frame
    garbage_bytes: int = 0

    def discard(self, length: int) -> None:
        """Count a stretch of garbage, if there is any."""
        if length:
            self.garbage += 1
            self.garbage_bytes += length

    def as_dict(self) -> dict[str, int]:
        """For ``health``."""
        return {f.name: getattr(self, f.name) for f in fields(self)}
