"""A camera that costs nothing: it shows images in memory at a steady rate."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from tacshade_edge.camera.frame_source import unix_ns
from tacshade_edge.types import U8, Frame


class RingSource:
    """A `FrameSource` that cycles through images of a file, uint8 (N, H, W);
    it drops late ones, as a camera does.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self._images: U8 = np.asarray(
            np.load(path, mmap_mode="r")
        )  # mapped: its pages are counted separately
        self._period_ns = round(1e9 / fps)
        self._zero_ns = self._next_seq = 0
        self.dropped = 0

    def open(self) -> None:
        """Start the clock."""
        self._zero_ns = time.monotonic_ns() - self._next_seq * self._period_ns

    def read(self) -> Frame:
        """Wait until the next frame is due; its time stamp is that time."""
        seq, t_ns = self._wait()
        image = self._images[seq % len(self._images)]
        return Frame(seq=seq, t_ns=t_ns, wall_ns=unix_ns(t_ns), image=image)

    def skip(self) -> bool:
        """Wait until the next frame is due."""
        self._wait()
        return True

    def _wait(self) -> tuple[int, int]:
        missed = max((time.monotonic_ns() - self._zero_ns) // self._period_ns - self._next_seq, 0)
        self.dropped += missed
        seq = self._next_seq + missed
        self._next_seq = seq + 1
        t_ns = self._zero_ns + seq * self._period_ns
        time.sleep(max(t_ns - time.monotonic_ns(), 0) / 1e9)
        return seq, t_ns

    def close(self) -> None:
        """Nothing to release."""

    def describe(self) -> dict[str, str | int | float]:
        """Describe the source."""
        return {"device": "ring", "images": len(self._images)}
