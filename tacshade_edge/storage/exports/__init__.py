"""A recording, reconstructed, in the files of others: each is there whole under its name, or not at all."""

from __future__ import annotations

from typing import Protocol

from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction


class Export(Protocol):
    """Gets every frame in order, then `finish` or `discard`; the methods raise DeviceError where the disk fails."""

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Take the next frame."""

    def finish(self) -> None:
        """Put it in its place."""

    def discard(self) -> None:
        """Remove what was begun; after `finish` there is nothing to remove."""
