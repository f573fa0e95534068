"""The interface that every frame source implements."""

from __future__ import annotations

from typing import Protocol

from tacshade_edge.types import Frame


class FrameSource(Protocol):
    """A source of frames. It blocks in `read`; the daemon's grab thread keeps the newest frame.

    Life cycle: ``open`` → ``read`` or ``skip`` … → ``close``. After any of them raises `DeviceError`, the caller
    calls ``close`` and may ``open`` again (a source keeps counting `Frame.seq` when it is reopened).
    """

    @property
    def dropped(self) -> int:
        """Number of frames known or inferred to be lost before this process saw them, since the first open."""
        ...

    def open(self) -> None:
        """Prepare to read. Raises DeviceError (absent, busy, not a camera) or ConfigError (can never work)."""
        ...

    def read(self) -> Frame | None:
        """Return the next frame; None when a finite source has ended. Raises DeviceError when the device is lost."""
        ...

    def skip(self) -> bool:
        """Discard the next frame; return False when a finite source has ended. Waits and raises as `read` does."""
        ...

    def close(self) -> None:
        """Release everything; safe to call twice."""
        ...

    def describe(self) -> dict[str, str | int | float]:
        """Return the negotiated settings (format, size, rate, time stamp source), for ``status/camera``."""
        ...
