"""Frames from image files, a video file or an MCAP file, at their own pace or a steady one."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.recording.recording import Entry, Recording
from tacshade_edge.types import Frame

_log = logging.getLogger(__name__)
# A stop does not wait longer for a frame, nor a person for what follows a pause.
_GAP_MAX_NS: Final = 1_000_000_000


class FilesSource:
    """A `FrameSource` for a folder of images, one image, a video file, or an MCAP file, in the
    order of `Recording`, with its poses; at their own times unless `fps` is given. A late reader
    gets the next frame at once, but never a burst.
    """

    def __init__(self, *, path: Path, fps: float | None, loop: bool) -> None:
        self._path = path
        self._fps = fps
        self._loop = loop
        self._seq = 0
        self._due_ns = 0
        self._size: tuple[int, int] | None = None
        self._recording: Recording | None = None
        self._following: Entry | None = None

    @property
    def dropped(self) -> int:
        """Always 0: a file loses nothing."""
        return 0

    def open(self) -> None:
        """Find the files. Raises ConfigError if there is no image, or the table is wrong."""
        self._recording = Recording(self._path, times=0 if self._loop else 1, video_table=False)
        if self._recording.damage:
            _log.warning("%s", self._recording.damage)
        self._following, self._due_ns = None, time.monotonic_ns()

    def read(self) -> Frame | None:
        """Wait until the next frame is due; None after the last.

        Raises DecodeError if this image is unusable; the next call continues with the next one.
        """
        if (entry := self._next_due()) is None:
            return None
        t_ns, wall_ns, seq, row = time.monotonic_ns(), time.time_ns(), self._seq, entry.row
        self._seq += 1
        image = entry.picture()
        height, width = image.shape[:2]
        # Calibrations are for one size: a folder in which sizes are mixed is two sensors.
        self._size = self._size or (height, width)
        if self._size != (height, width):
            expected = f"{self._size[1]}x{self._size[0]} px, the first image's size"
            raise DecodeError(
                f"{self._path}: {row.image}: found {width}x{height} px, expected {expected}"
            )
        # The pose is dated anew with its frame: a table of last year is played now.
        pose = None if row.pose is None else replace(row.pose, t_ns=t_ns)
        return Frame(seq, t_ns, wall_ns, image, pose, row.pose_error_us)

    def skip(self) -> bool:
        """Wait until the next frame is due but do not decode it; return False after the last."""
        entry = self._next_due()
        self._seq += entry is not None
        return entry is not None

    def _next_due(self) -> Entry | None:
        """Wait until the next picture is due; None after the last."""
        if (recording := self._recording) is None:
            return None
        entry = self._following or recording.next_entry()
        if entry is None:
            return None
        late_ns = time.monotonic_ns() - self._due_ns
        if late_ns < 0:
            time.sleep(-late_ns / 1e9)
        else:
            # The schedule moves with a late reader, whom frames that fell due meanwhile would
            # otherwise reach as a burst.
            self._due_ns += late_ns
        self._following = recording.next_entry()
        if (fps := self._fps or recording.fps) is not None:
            self._due_ns += round(1e9 / fps)
        elif self._following is not None:
            gap_ns = self._following.row.t_ns - entry.row.t_ns
            self._due_ns += min(max(gap_ns, 0), _GAP_MAX_NS)
        return entry

    def close(self) -> None:
        """Release the files."""
        self._recording = None

    def describe(self) -> dict[str, str | int | float]:
        """The path, the frame rate, and the number of images if known."""
        about: dict[str, str | int | float] = {"path": str(self._path)}
        fps = self._fps or (self._recording.fps if self._recording else None)
        about |= {"fps": fps} if fps else {}
        images = self._recording.images if self._recording else 0
        return about | ({"images": images} if images else {})


def first_size_px(path: Path) -> tuple[int, int] | None:
    """The width and height of the first image in px; None if it is unusable.

    Raises ConfigError if there is none.
    """
    if (entry := Recording(path, video_table=False).next_entry()) is None:
        raise ConfigError(f"{path}: found no image, expected an MCAP file with images")
    try:
        image = entry.picture()
    except DecodeError:
        return None
    return image.shape[1], image.shape[0]
