"""Reads a video with its own times, and says when it ends before its end."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import cv2
import numpy as np

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.file_kinds import kind_at
from tacshade_edge.files.image_bytes import PIXELS_MAX, SIDE_MAX_PX
from tacshade_edge.quoting import counted, shown
from tacshade_edge.recording.frame_table import T_NS_MAX
from tacshade_edge.regular_files import open_regular
from tacshade_edge.types import U8

# OpenCV passes this variable to FFmpeg; there is no other way. By default FFmpeg also opens
# playlists, which can name any file or address.
_FFMPEG_OPTIONS: Final = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_FILES_ONLY: Final = (
    "protocol_whitelist;file|format_whitelist;avi,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2"
)
_FILE_BYTES_MAX: Final = 1 << 50
# Of boxes on the top level: a fragment has two.
_BOXES_MAX: Final = 1 << 20
_EBML, _SEGMENT = 0x1A45DFA3, 0x18538067
_BOXES: Final = (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip")
DEFAULT_FPS: Final = 30.0
# As of the option --fps; damaged files state others.
RATE_LEAST_HZ, RATE_MOST_HZ = 1e-3, 1e6
_STATED_MS_MAX: Final = T_NS_MAX / 1e6


class Video:
    """An opened video file.

    `fps` is the rate that it states, `DEFAULT_FPS` if it states none. Raises ConfigError if it is
    none that can be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        # Whatever the user's environment says; OpenCV reads it at each opening.
        os.environ[_FFMPEG_OPTIONS] = _FILES_ONLY
        video = _opened(path)
        width, height = (
            int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        # Before a frame is decoded: memory for the stated size is allocated then.
        if video.isOpened() and (max(width, height) > SIDE_MAX_PX or width * height > PIXELS_MAX):
            raise ConfigError(
                f"{path}: found {width}x{height} px, expected at most {SIDE_MAX_PX} px per side"
            )
        # isOpened is also true for a file none of whose frames can be decoded.
        if not video.isOpened() or not video.grab():
            raise ConfigError(f"{path}: {_unreadable(path)}")
        fps, count = video.get(cv2.CAP_PROP_FPS), video.get(cv2.CAP_PROP_FRAME_COUNT)
        self.fps = fps if RATE_LEAST_HZ <= fps <= RATE_MOST_HZ else DEFAULT_FPS
        self._stated = int(count) if math.isfinite(count) and count > 0 else 0

    def __iter__(self) -> Iterator[tuple[int, U8]]:
        """Every frame's time since the first, ns, and its picture.

        Raises DecodeError at the end of a file that ends before its end.
        """
        # Opened again: winding back finds no frame in a video of one.
        video = _opened(self._path)
        first_ns = t_ns = count = 0
        # What some containers state no better than by numbers; without it, equal times.
        period_ns = round(1e9 / self.fps)
        while (grabbed := video.read())[0]:
            stated_ms = video.get(cv2.CAP_PROP_POS_MSEC)
            stated_ns = round(stated_ms * 1e6) if abs(stated_ms) <= _STATED_MS_MAX else 0
            first_ns = first_ns if count else stated_ns
            later_ns = stated_ns - first_ns
            t_ns = 0 if not count else later_ns if later_ns > t_ns else t_ns + period_ns
            count += 1
            yield t_ns, np.asarray(grabbed[1], np.uint8)
        video.release()
        # By the time as well: an AVI counts the repeated frames that it does not contain.
        is_short = self._stated > count and self._stated * period_ns - t_ns > 1.5 * period_ns
        if (_is_cut(self._path) and self._stated != count) or (is_short and self._is_counted):
            of = f" of {self._stated}" if self._stated > count else ""
            raise DecodeError(
                f"{shown(self._path)}: the video ends after {count}{of} frames, expected the whole "
                "file; its writer or its copy was cut off"
            )

    @property
    def _is_counted(self) -> bool:
        """Whether the container states the number of frames; Matroska has only a duration, which
        may be that of the sound.
        """
        with open_regular(self._path, _FILE_BYTES_MAX) as stream:
            return int.from_bytes(stream.read(4), "big") != _EBML


def _opened(path: Path) -> cv2.VideoCapture:
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    # As stored, like images: a turned picture would not fit its calibration.
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def _is_cut(path: Path) -> bool:
    """Whether a file is shorter than the container in it states."""
    try:
        with open_regular(path, _FILE_BYTES_MAX) as stream:
            size = os.fstat(stream.fileno()).st_size
            return _end_of(stream, size) > size
    except OSError:
        return False


def _end_of(stream: BinaryIO, size: int) -> int:
    """The byte at which the container says that it ends; 0 if it does not say."""
    head = stream.read(4)
    stream.seek(0)
    at = 0
    if head == b"RIFF":
        # A long AVI has several.
        while at < size and (riff := stream.read(8))[:4] == b"RIFF":
            length = int.from_bytes(riff[4:], "little")
            # Its writer writes the length last.
            at = at + 8 + length + length % 2 if length else size + 1
            stream.seek(at)
        return at
    if int.from_bytes(head, "big") == _EBML:
        kind = 0
        while kind != _SEGMENT and at < size:
            kind, length, begin = _element(stream, at)
            at = begin + length
        return at if kind == _SEGMENT else 0
    return _boxes(stream, size)[0]


def _element(stream: BinaryIO, at: int) -> tuple[int, int, int]:
    """The kind, length and first byte of a Matroska element; the length is 0 if unknown."""
    stream.seek(at)
    # A kind has up to 4 bytes, a length up to 8.
    head = stream.read(4 + 8)
    if len(head) < 4 + 8 or not head[0]:
        return _SEGMENT, 0, 0
    kinds = 9 - head[0].bit_length()
    kind, rest = int.from_bytes(head[:kinds], "big"), head[kinds:]
    lengths = 9 - rest[0].bit_length() if rest[0] else 8
    stream.seek(at + kinds)
    stated = int.from_bytes(stream.read(lengths), "big") & ((1 << 7 * lengths) - 1)
    # All ones: unknown, as in a stream.
    return kind, stated if stated != (1 << 7 * lengths) - 1 else 0, at + kinds + lengths


def _boxes(stream: BinaryIO, size: int) -> tuple[int, list[bytes]]:
    """The end of the boxes of an MP4 or QuickTime file, and the kinds of the whole ones."""
    at, kinds = 0, list[bytes]()
    while at < size and len(kinds) < _BOXES_MAX:
        stream.seek(at)
        head = stream.read(16)
        length, begin = int.from_bytes(head[:4], "big"), 8
        if length == 1:
            length, begin = int.from_bytes(head[8:16], "big"), 16
        # 0: until the end of the file.
        at = size if length == 0 else at + length if length >= begin else size
        kinds += [head[4:8]] if at <= size else []
    return at, kinds


def _unreadable(path: Path) -> str:
    """Why OpenCV cannot read a file."""
    expected = "expected a video file or a folder of images"
    try:
        with open_regular(path, _FILE_BYTES_MAX) as stream:
            size = os.fstat(stream.fileno()).st_size
            _, kinds = _boxes(stream, size)
    except OSError:
        kinds = []
    if kinds and kinds[0] in _BOXES and b"moov" not in kinds:
        return (
            f"found a video of {counted(size, 'byte')} without its index (moov), which is written "
            "last: its writer or its copy was cut off; expected the whole file"
        )
    return f"found {kind_at(path) or 'a file that OpenCV cannot read'}, {expected}"
