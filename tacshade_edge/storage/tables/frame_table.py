"""Tables of images with poses: a recording's frames (frames.csv), and POSES.csv of ``stitch``."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import quoted
from tacshade_edge.regular_files import named_file
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.storage.atomic_files import part
from tacshade_edge.storage.tables.tables import CRC_COLUMN, iter_rows, number, read_columns
from tacshade_edge.types import Pose

HEADER = ("image", "t_ns", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
ERROR_COLUMN = "pose_error_us"
MORE = (ERROR_COLUMN, CRC_COLUMN)  # optional: older tables have neither, or only the first
TABLE_NAME = "frames.csv"
T_NS_MAX = 2**62  # a looped recording continues from its last time, and the wire format holds 64 bits
ROWS_MAX = 1 << 21  # 9.7 h at 60 frames/s; 150 bytes of memory each
UNIT_TOLERANCE = 1e-3
ERROR_US_MAX = 2**32 - 1  # as in the wire format


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; `pose_error_us` is the greatest time between the pose and `t_ns`."""

    image: str
    t_ns: int
    pose: Pose | None
    pose_error_us: int = 0


class FrameTable(Sequence[Row]):
    """The rows of a table, packed: one `Row` object each would take three times the memory.

    `damaged` counts the lines left out because their checksum does not match; `first_damaged` is the first one's
    ``FILE:LINE``.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self.first_damaged = ""
        self._images: list[str] = []
        self._t_ns = array("q")
        self._poses = array("d")
        self._errors_us = array("q")  # -1 without a pose

    def append(self, row: Row) -> None:
        """Append a row."""
        pose = row.pose
        values = (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz) if pose else (0.0,) * 7
        self._images.append(row.image)
        self._t_ns.append(row.t_ns)
        self._poses.extend(values)
        self._errors_us.append(row.pose_error_us if pose else -1)

    @property
    def damage(self) -> str:
        """A line for a person about the lines left out; empty if there are none."""
        if not self.damaged:
            return ""
        lines = (
            "a damaged line and its frame" if self.damaged == 1 else f"{self.damaged} damaged lines and their frames"
        )
        return f"{self.first_damaged}: left out {lines}, because the checksum does not match"

    def __len__(self) -> int:
        """The number of rows."""
        return len(self._images)

    @overload
    def __getitem__(self, index: int) -> Row: ...

    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...

    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        """One row, or a list of rows for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        at = range(len(self))[index]
        t_ns, error_us = self._t_ns[at], self._errors_us[at]
        pose = None if error_us < 0 else Pose(t_ns, *self._poses[7 * at : 7 * at + 7])
        return Row(self._images[at], t_ns, pose, max(error_us, 0))


def table_in(folder: Path) -> Path | None:
    """The path of a folder's table of frames, or of the ``.part`` that a crashed writer left; None without either."""
    table = folder / TABLE_NAME
    return next((path for path in (table, part(table)) if path.exists()), None)


def read_table(path: Path, *, cut_off: bool = False) -> FrameTable:
    """Read ``image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz``; the seven pose columns of a row are all filled or all empty.

    ``pose_error_us`` may follow; empty means 0. ``crc32`` may follow that; lines that do not match it are left out and
    counted. With `cut_off`, an unterminated last line is left out, as in a recording whose writer crashed. Raises
    ConfigError for a mistake, time stamps that do not increase, no row, or more than `ROWS_MAX`.
    """
    rows = FrameTable()
    last_ns = -1

    def leave_out(where: str) -> None:
        rows.damaged += 1
        rows.first_damaged = rows.first_damaged or where

    read = iter_rows(path, HEADER, "frames", more=MORE, cut_off=cut_off, rows_max=ROWS_MAX, on_damage=leave_out)
    for where, columns in read:
        row = _row(where, columns)
        if row.t_ns <= last_ns:
            raise ConfigError(f"{where}: t_ns: found {row.t_ns}, expected more than the previous row's {last_ns}")
        rows.append(row)
        last_ns = row.t_ns
    if not rows:
        damage = f" ({rows.damage})" if rows.damage else ""
        raise ConfigError(f"{path}: found no rows, expected one per frame{damage}")
    return rows


def _row(where: str, columns: list[str]) -> Row:
    name, time, *pose = columns[: len(HEADER)]
    error = "".join(columns[len(HEADER) :])
    if not name:
        raise ConfigError(f"{where}: image: found nothing, expected a file name or the number of a video frame")
    if not _whole(time, T_NS_MAX):
        raise ConfigError(f"{where}: t_ns: found {quoted(time)}, expected a whole number from 0 to 2^62")
    empty = [text == "" for text in pose]
    if error and not (_whole(error, ERROR_US_MAX) and not all(empty)):
        expected = (
            "nothing, because the row has no pose" if all(empty) else "a whole number from 0 to 2^32 - 1, or nothing"
        )
        raise ConfigError(f"{where}: {ERROR_COLUMN}: found {quoted(error)}, expected {expected}")
    if all(empty):
        return Row(name, int(time), None)
    if any(empty):
        raise ConfigError(f"{where}: x_mm to qz: found {7 - sum(empty)} of the 7 values, expected all or none")
    values = [number(where, column, text) for column, text in zip(HEADER[2:], pose, strict=True)]
    if abs((norm := math.hypot(*values[3:])) - 1) > UNIT_TOLERANCE:
        raise ConfigError(f"{where}: qw, qx, qy, qz: found a quaternion of length {norm:.4g}, expected length 1")
    return Row(name, int(time), Pose(int(time), *values), int(error or "0"))


def _whole(text: str, most: int) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 20 and int(text) <= most


POSES_HEADER = ("image", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
POSES_MAX = 100_000
_POSES_UNIT = 0.01


@dataclass(frozen=True, slots=True)
class PosedImage:
    """A line of the table; `where` is ``FILE:LINE``."""

    where: str
    path: Path
    base_T_flange: Rigid


def read_poses(path: Path) -> list[PosedImage]:
    """Read the table but not its images, whose paths are relative to it.

    Raises ConfigError for a mistake (``FILE:LINE: column: found …, expected …``), or if the table has no row.
    """
    table = read_columns(path, POSES_HEADER, (), "poses", rows_max=POSES_MAX)
    if table.unknown:
        raise ConfigError(f"{path}:1: {table.unknown[0]}: found an unknown column, expected {','.join(POSES_HEADER)}")
    if not table.rows:
        raise ConfigError(f"{path}: found no rows, expected one per image")
    return [_posed(path, where, table.with_points(row)) for where, row in table.rows]


def _posed(path: Path, where: str, row: dict[str, str]) -> PosedImage:
    values = [number(where, column, row[column]) for column in POSES_HEADER[1:]]
    norm = math.hypot(*values[3:])
    if abs(norm - 1) > _POSES_UNIT:
        raise ConfigError(f"{where}: qw, qx, qy, qz: found a quaternion of length {norm:.4g}, expected length 1")
    if not row["image"]:
        raise ConfigError(f"{where}: image: found nothing, expected a file name")
    return PosedImage(where, named_file(path.parent, row["image"]), from_seven(values))
