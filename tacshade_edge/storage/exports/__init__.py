"""Exports a reconstructed recording to other programs' formats; each file appears whole or not at all."""

from __future__ import annotations

from typing import Protocol

from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction


class Export(Protocol):
    """Takes every frame in order, then `finish` or `discard`; the methods raise DeviceError if the disk fails."""

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Add the next frame."""

    def finish(self) -> None:
        """Complete the export and move it to its final name."""

    def discard(self) -> None:
        """Remove an unfinished export; after `finish` do nothing."""
