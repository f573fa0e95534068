"""Frames from image files or a video file, at a steady pace."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core.image.image_bytes import PIXELS_MAX, SIDE_MAX_PX
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.storage.images import SUFFIXES, read_image
from tacshade_edge.storage.recording.mcap import is_mcap, mcap_frames
from tacshade_edge.storage.tables.frame_table import FrameTable, Row, read_table, table_in
from tacshade_edge.types import U8, Frame

_log = logging.getLogger(__name__)
_Picture = Path | U8 | Callable[[], U8]

# OpenCV passes this variable to FFmpeg; there is no other way. By default FFmpeg also opens playlists, which can name
# any file or address.
_FFMPEG_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_FILES_ONLY = "protocol_whitelist;file|format_whitelist;avi,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2"


class FilesSource:
    """A `FrameSource` for a folder of images, one image, a video file, or an MCAP file.

    A folder's images come in the order of its table (`frame_table`), with its poses, or else of their names; an MCAP
    file's images come in its order, with its poses. A late reader gets the next frame at once, but never a burst.
    """

    def __init__(self, *, path: Path, fps: float, loop: bool) -> None:
        self._path = path
        self._fps, self._period_ns = fps, round(1e9 / fps)
        self._loop = loop
        self._seq = 0
        self._due_ns = 0
        self._size: tuple[int, int] | None = None
        self._images: list[Path] = []
        self._rows: FrameTable | None = None
        self._video: cv2.VideoCapture | None = None
        self._items: Iterator[tuple[_Picture, Row | None]] = iter(())

    @property
    def dropped(self) -> int:
        """Always 0: a file loses nothing."""
        return 0

    def open(self) -> None:
        """Find the files. Raises ConfigError if there is no image, or the table is wrong."""
        self.close()
        if not is_mcap(self._path):
            self._images, self._video = look_at(self._path)
        self._rows = _rows(self._path)
        if self._rows is not None and self._rows.damage:
            _log.warning("%s", self._rows.damage)
        self._items = self._next_items()
        self._due_ns = time.monotonic_ns()

    def read(self) -> Frame | None:
        """Wait until the next frame is due; None after the last.

        Raises DecodeError if this image is unusable; the next call continues with the next one.
        """
        if (entry := self._next_due()) is None:
            return None
        item, row = entry
        t_ns, wall_ns, seq = time.monotonic_ns(), time.time_ns(), self._seq
        self._seq += 1
        frame = Frame(seq=seq, t_ns=t_ns, wall_ns=wall_ns, image=self._checked(item))
        if row is None or row.pose is None:
            return frame
        return replace(frame, pose=replace(row.pose, t_ns=t_ns), pose_error_us=row.pose_error_us)

    def skip(self) -> bool:
        """Wait until the next frame is due but do not decode it; return False after the last."""
        entry = self._next_due()
        self._seq += entry is not None
        return entry is not None

    def _next_due(self) -> tuple[_Picture, Row | None] | None:
        """Wait until the next picture is due; return it with its row of the table, or None after the last."""
        if (entry := next(self._items, None)) is None:
            return None
        late_ns = time.monotonic_ns() - self._due_ns
        if late_ns < 0:
            time.sleep(-late_ns / 1e9)
        else:
            self._due_ns += late_ns
        self._due_ns += self._period_ns
        return entry

    def close(self) -> None:
        """Release the video file."""
        if self._video is not None:
            self._video.release()
        self._video, self._images, self._rows, self._items = None, [], None, iter(())

    def describe(self) -> dict[str, str | int | float]:
        """The path, the frame rate, and the number of images if known."""
        about: dict[str, str | int | float] = {"path": str(self._path), "fps": self._fps}
        images = len(self._images if self._rows is None else self._rows)
        return about | ({"images": images} if images else {})

    def _next_items(self) -> Iterator[tuple[_Picture, Row | None]]:
        mcap = mcap_frames(self._path) if is_mcap(self._path) else None
        if mcap is not None and mcap.damage:
            _log.warning("%s", mcap.damage)
        while True:
            if mcap is not None:
                yield from ((picture, row) for row, picture, _ in mcap)
            elif self._rows is not None:
                yield from ((self._path / row.image, row) for row in self._rows)
            else:
                yield from ((image, None) for image in self._images)
            if self._video is not None:
                while (grabbed := self._video.read())[0]:
                    yield np.asarray(grabbed[1], dtype=np.uint8), None
                self._video.set(cv2.CAP_PROP_POS_FRAMES, 0)
            if not self._loop:
                return

    def _checked(self, item: _Picture) -> U8:
        if isinstance(item, np.ndarray):
            return item
        image = read_image(item) if isinstance(item, Path) else item()
        height, width = image.shape[:2]
        if self._size is None:
            self._size = (height, width)
        if self._size != (height, width):
            expected = f"{self._size[1]}x{self._size[0]} px, the first image's size"
            raise DecodeError(
                f"{item if isinstance(item, Path) else self._path}: found {width}x{height} px, expected {expected}"
            )
        return image


def first_size_px(path: Path) -> tuple[int, int] | None:
    """The width and height of the first image in px; None if it cannot be decoded.

    Raises ConfigError if there is no image, or the table is wrong.
    """
    if is_mcap(path):
        return _first_size_of_mcap(path)
    images, video = look_at(path)
    if video is not None:
        size_px = int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))
        video.release()
        return size_px
    rows = _rows(path)
    try:
        image = read_image(path / rows[0].image if rows else images[0])
    except DecodeError:
        return None
    return image.shape[1], image.shape[0]


def _first_size_of_mcap(path: Path) -> tuple[int, int] | None:
    for _, picture, _ in mcap_frames(path):
        try:
            image = picture()
        except DecodeError:
            return None
        return image.shape[1], image.shape[0]
    raise ConfigError(f"{path}: found no image, expected an MCAP file with images")


def _rows(path: Path) -> FrameTable | None:
    table = table_in(path) if path.is_dir() else None
    return None if table is None else read_table(table, cut_off=table.suffix == ".part")


def look_at(path: Path) -> tuple[list[Path], cv2.VideoCapture | None]:
    """The paths of a folder's images or of one image, or the opened video. Raises ConfigError."""
    if path.is_dir():
        images = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
        if not images:
            raise ConfigError(f"{path}: found no image, expected a folder of {', '.join(sorted(SUFFIXES))} files")
        return images, None
    if not path.is_file():
        raise ConfigError(f"{path}: found nothing, expected a folder of images, an image or a video file")
    if path.suffix.lower() in SUFFIXES:
        return [path], None
    os.environ[_FFMPEG_OPTIONS] = _FILES_ONLY
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not video.isOpened():
        raise ConfigError(f"{path}: found a file that OpenCV cannot read, expected a video file or a folder of images")
    width, height = (int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if max(width, height) > SIDE_MAX_PX or width * height > PIXELS_MAX:
        raise ConfigError(f"{path}: found {width}x{height} px, expected at most {SIDE_MAX_PX} px per side")
    if not video.grab():
        raise ConfigError(f"{path}: found a file that OpenCV cannot read, expected a video file or a folder of images")
    video.set(cv2.CAP_PROP_POS_FRAMES, 0)
    return [], video
