"""The table beside the frames of a recording: their order, time stamps and poses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.devices.files.tables import number, read_rows
from tacshade_edge.devices.files.whole_files import part
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Pose

HEADER = ("image", "t_ns", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
ERROR_COLUMN = "pose_error_us"  # may be missing: older tables have none
TABLE_NAME = "frames.csv"
T_NS_MAX = 2**62  # a looped recording goes on from here, and the wire holds 64 bits
UNIT_TOLERANCE = 1e-3
ERROR_US_MAX = 2**32 - 1  # as on the wire


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; `pose_error_us` is how far from `t_ns` the pose is known."""

    image: str
    t_ns: int
    pose: Pose | None
    pose_error_us: int = 0


def table_in(folder: Path) -> Path | None:
    """The table of a folder of frames, or the ``.part`` that a writer who died has left; None without one."""
    table = folder / TABLE_NAME
    return next((path for path in (table, part(table)) if path.exists()), None)


def read_table(path: Path, *, cut_off: bool = False) -> list[Row]:
    """Read ``image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz``; the seven columns of the pose may be empty, all or none.

    ``pose_error_us`` may be the last column: empty is 0.

    `cut_off` leaves out a last line without an end: of a recording whose writer died.

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``; time stamps that do not increase; no row.
    """
    rows: list[Row] = []
    for where, columns in read_rows(path, HEADER, "frames", more=(ERROR_COLUMN,), cut_off=cut_off):
        row = _row(where, columns)
        if rows and row.t_ns <= rows[-1].t_ns:
            raise ConfigError(f"{where}: t_ns: found {row.t_ns}, expected more than {rows[-1].t_ns} of the row before")
        rows.append(row)
    if not rows:
        raise ConfigError(f"{path}: found no row, expected one for each frame")
    return rows


def _row(where: str, columns: list[str]) -> Row:
    name, time, *pose = columns[: len(HEADER)]
    error = "".join(columns[len(HEADER) :])
    if not name:
        raise ConfigError(f"{where}: image: found nothing, expected a file's name, or a frame's number in a video")
    if not _whole(time, T_NS_MAX):
        raise ConfigError(f"{where}: t_ns: found {time!r}, expected a whole number from 0 to 2^62")
    empty = [text == "" for text in pose]
    if error and not (_whole(error, ERROR_US_MAX) and not all(empty)):
        expected = "nothing, as there is no pose" if all(empty) else "a whole number from 0 to 2^32 - 1, or nothing"
        raise ConfigError(f"{where}: {ERROR_COLUMN}: found {error!r}, expected {expected}")
    if all(empty):
        return Row(name, int(time), None)
    if any(empty):
        raise ConfigError(f"{where}: x_mm to qz: found {7 - sum(empty)} of the 7, expected all or none")
    values = [number(where, column, text) for column, text in zip(HEADER[2:], pose, strict=True)]
    if abs((norm := math.hypot(*values[3:])) - 1) > UNIT_TOLERANCE:
        raise ConfigError(f"{where}: qw, qx, qy, qz: found the norm {norm:.4g}, expected a unit quaternion")
    return Row(name, int(time), Pose(int(time), *values), int(error or "0"))


def _whole(text: str, most: int) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 20 and int(text) <= most
