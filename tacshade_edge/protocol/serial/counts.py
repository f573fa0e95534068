"""Counts of the robot's line."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(slots=True)
class LinkCounts:
    """Counts since the start. Every numbered pose between two that arrived is in `poses` or `poses_lost`."""

    bytes: int = 0
    lines: int = 0
    commands: int = 0  # passed on, each once
    repeats: int = 0  # answered from the cache, or still in progress
    refused: int = 0  # answered with ERR, not passed on
    echoes: int = 0  # our own lines, returned
    poses: int = 0
    poses_lost: int = 0  # by their numbers
    poses_repeated: int = 0
    poses_bad: int = 0  # undamaged, but not a valid pose
    damaged: int = 0  # lines and frames with a wrong checksum
    garbage: int = 0  # runs of bytes that are neither line nor frame
    garbage_bytes: int = 0

    def discard(self, length: int) -> None:
        """Count a run of garbage, if there is any."""
        if length:
            self.garbage += 1
            self.garbage_bytes += length

    def as_dict(self) -> dict[str, int]:
        """The counts by name, for ``health``."""
        return {f.name: getattr(self, f.name) for f in fields(self)}
