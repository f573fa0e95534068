"""A recording: images or a video with their own time stamps, read frame by frame and never dropped.

The table beside it is ``frames.csv`` in a folder, and ``NAME.csv`` beside a video ``NAME.mp4``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.devices.files import look_at
from tacshade_edge.devices.images import SUFFIXES, read_image
from tacshade_edge.devices.tables import number, read_rows
from tacshade_edge.devices.whole_files import part
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import U8, Frame, Pose

HEADER = ("image", "t_ns", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
TABLE_NAME = "frames.csv"
DEFAULT_FPS = 30.0
T_NS_MAX = 2**62  # a looped recording goes on from here, and the wire holds 64 bits
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    image: str
    t_ns: int
    pose: Pose | None


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """A frame with the name of its image (of a video: the frame's number)."""

    name: str
    frame: Frame


def read_table(path: Path, *, cut_off: bool = False) -> list[Row]:
    """Read ``image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz``; the seven columns of the pose may be empty, all or none.

    `cut_off` leaves out a last line without an end: of a recording whose writer died.

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``; time stamps that do not increase; no row.
    """
    rows: list[Row] = []
    for where, columns in read_rows(path, HEADER, "frames", cut_off=cut_off):
        row = _row(where, columns)
        if rows and row.t_ns <= rows[-1].t_ns:
            raise ConfigError(f"{where}: t_ns: found {row.t_ns}, expected more than {rows[-1].t_ns} of the row before")
        rows.append(row)
    if not rows:
        raise ConfigError(f"{path}: found no row, expected one for each frame")
    return rows


def _row(where: str, columns: list[str]) -> Row:
    name, time, *pose = columns
    if not name:
        raise ConfigError(f"{where}: image: found nothing, expected a file's name, or a frame's number in a video")
    if not (time.isascii() and time.isdecimal() and len(time) < 20 and int(time) <= T_NS_MAX):
        raise ConfigError(f"{where}: t_ns: found {time!r}, expected a whole number from 0 to 2^62")
    empty = [text == "" for text in pose]
    if all(empty):
        return Row(name, int(time), None)
    if any(empty):
        raise ConfigError(f"{where}: x_mm to qz: found {7 - sum(empty)} of the 7, expected all or none")
    values = [number(where, column, text) for column, text in zip(HEADER[2:], pose, strict=True)]
    if abs((norm := math.hypot(*values[3:])) - 1) > UNIT_TOLERANCE:
        raise ConfigError(f"{where}: qw, qx, qy, qz: found the norm {norm:.4g}, expected a unit quaternion")
    return Row(name, int(time), Pose(int(time), *values))


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
        self.cut_off = self._table is not None and self._table == part(path / TABLE_NAME)
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
        return RecordedFrame(row.image, Frame(seq=seq, t_ns=row.t_ns, wall_ns=0, image=image, pose=row.pose))

    def _one_pass(self) -> Iterator[tuple[Row, Path | U8]]:
        first_ns = last_ns = count = 0
        for row, picture in self._items():
            first_ns = row.t_ns if count == 0 else first_ns
            last_ns = row.t_ns
            count += 1
            t_ns = row.t_ns + self._shift_ns
            yield Row(row.image, t_ns, None if row.pose is None else replace(row.pose, t_ns=t_ns)), picture
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

    def _video(self, video: cv2.VideoCapture, rows: list[Row] | None) -> Iterator[tuple[Row, U8]]:
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
        table = path / TABLE_NAME
        if not table.exists() and part(table).exists():
            return part(table)
    elif path.is_file() and path.suffix.lower() not in SUFFIXES:
        table = path.with_suffix(".csv")
    else:
        table = path
    if table != path and table.exists():
        return table
    look_at(path)  # says what is wrong with it
    return None
