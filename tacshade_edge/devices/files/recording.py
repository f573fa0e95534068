"""A recording: images or a video with their own time stamps, read frame by frame and never dropped.

The table beside it is ``frames.csv`` in a folder, and ``NAME.csv`` beside a video ``NAME.mp4``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.devices.files.frame_table import FrameTable, Row, read_table, table_in
from tacshade_edge.devices.files.image_source import look_at
from tacshade_edge.devices.files.images import SUFFIXES, read_image
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import U8, Frame

DEFAULT_FPS = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """A frame with the name of its image (of a video: the frame's number)."""

    name: str
    frame: Frame


class Recording:
    """A folder of images, one image, or a video file, in the order and at the times of its table.

    Parameters
    ----------
    path : Path
    fps : float or None
        Makes the time stamps (from 0) where no table is, 30 by default; refused where one is.
    times : int
        How often it is gone through; 0 is for ever. Time stamps and numbers go on growing.

    Attributes
    ----------
    cut_off : bool
        Its writer died: what it wrote until then is here.

    Raises
    ------
    ConfigError
        Nothing to replay, or a wrong table.
    """

    def __init__(self, path: Path, *, fps: float | None = None, times: int = 1) -> None:
        self._path = path
        self._period_ns = 1e9 / (fps or DEFAULT_FPS)
        self._table = _table_beside(path)
        self.cut_off = self._table is not None and self._table.suffix == ".part"
        self._rows = None if self._table is None else read_table(self._table, cut_off=self.cut_off)
        if fps is not None and self._table is not None:
            raise ConfigError(f"--fps: found {fps:g}, expected none: {self._table} has the time stamps")
        self._shift_ns = 0
        passes = itertools.count() if times == 0 else range(times)
        self._entries = enumerate(entry for _ in passes for entry in self._one_pass())

    def read(self) -> RecordedFrame | None:
        """The next frame; None after the last.

        Raises
        ------
        DecodeError
            This image cannot be used; the next call goes on with the next, and its number is left out.
        ConfigError
            The table has more or fewer rows than the video has frames.
        """
        entry = next(self._entries, None)
        if entry is None:
            return None
        seq, (row, picture) = entry
        image = read_image(picture) if isinstance(picture, Path) else picture
        # No wall clock was there: 0, so that equal recordings give equal bytes.
        frame = Frame(seq, row.t_ns, 0, image, row.pose, row.pose_error_us)
        return RecordedFrame(row.image, frame)

    def _one_pass(self) -> Iterator[tuple[Row, Path | U8]]:
        first_ns = last_ns = count = 0
        for row, picture in self._items():
            first_ns = row.t_ns if count == 0 else first_ns
            last_ns = row.t_ns
            count += 1
            t_ns = row.t_ns + self._shift_ns
            pose = None if row.pose is None else replace(row.pose, t_ns=t_ns)
            yield replace(row, t_ns=t_ns, pose=pose), picture
        self._shift_ns += (
            last_ns - first_ns + round((last_ns - first_ns) / (count - 1) if count > 1 else self._period_ns)
        )

    def _items(self) -> Iterator[tuple[Row, Path | U8]]:
        rows = self._rows
        if rows is not None and self._path.is_dir():
            yield from ((row, self._path / row.image) for row in rows)
            return
        images, video = look_at(self._path)
        for index, image in enumerate(images):
            yield Row(image.name, round(index * self._period_ns), None), image
        if video is not None:
            yield from self._video(video, rows)
            video.release()

    def _video(self, video: cv2.VideoCapture, rows: FrameTable | None) -> Iterator[tuple[Row, U8]]:
        index = 0
        while (grabbed := video.read())[0]:
            image = np.asarray(grabbed[1], dtype=np.uint8)
            if rows is None:
                yield Row(str(index), round(index * self._period_ns), None), image
            elif index == len(rows) or rows[index].image != str(index):
                found = f"row {index + 1} of frame {rows[index].image!r}" if index < len(rows) else f"{index} rows"
                raise ConfigError(f"{self._table}: found {found}, expected one for each frame of the video, from 0")
            else:
                yield rows[index], image
            index += 1
        if rows is not None and index < len(rows):
            raise ConfigError(f"{self._table}: found {len(rows)} rows, expected {index}, the frames of the video")


def _table_beside(path: Path) -> Path | None:
    if path.is_dir():
        if (found := table_in(path)) is not None:
            return found
        table = path
    elif path.is_file() and path.suffix.lower() not in SUFFIXES:
        table = path.with_suffix(".csv")
    else:
        table = path
    if table != path and table.exists():
        return table
    look_at(path)  # says what is wrong with it
    return None
