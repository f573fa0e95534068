"""The one interface of every frame source."""

from __future__ import annotations

from typing import Protocol

from tacshade_edge.types import Frame


class FrameSource(Protocol):
    """Where frames come from. A source blocks in `read`; the daemon's grab thread keeps the newest.

    Life: ``open`` → ``read`` or ``skip`` … → ``close``; after a `DeviceError` from one of them the caller
    calls ``close`` and may ``open`` again (a source keeps counting `Frame.seq` across a reopening).
    """

    @property
    def dropped(self) -> int:
        """Frames known or inferred to be lost before this process saw them, since the first open."""
        ...

    def open(self) -> None:
        """Make ready to read. Raises DeviceError (absent, busy, not a camera) or ConfigError (can never work)."""
        ...

    def read(self) -> Frame | None:
        """The next frame; None when a finite source has ended. Raises DeviceError when the device is lost."""
        ...

    def skip(self) -> bool:
        """Let the next frame go by without looking at it; otherwise as `read`: False when a finite source has ended."""
        ...

    def close(self) -> None:
        """Release everything; safe to call twice."""
        ...

    def describe(self) -> dict[str, str | int | float]:
        """What was negotiated (format, size, rate, time stamp source), for ``status/camera``."""
        ...
