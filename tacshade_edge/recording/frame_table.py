"""Tables of images with poses: a recording's frames (frames.csv), and POSES.csv of ``stitch``."""

from __future__ import annotations

import csv
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import part
from tacshade_edge.files.tables import BYTES_A_ROW_MAX, is_row_numbers, number, read_columns
from tacshade_edge.plausibility.frame_times import STEPS_JUDGED, judge_steps, judge_time_cell
from tacshade_edge.plausibility.suspicions import SuspicionCode, suspicion
from tacshade_edge.quoting import counted, quoted, shown
from tacshade_edge.regular_files import named_file, open_regular
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.types import Pose

_POSE = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
HEADER = ("image", "t_ns", *_POSE)
ERROR_COLUMN, CRC_COLUMN = "pose_error_us", "crc32"
# Optional: older tables have neither, or only the first.
MORE = (ERROR_COLUMN, CRC_COLUMN)
TABLE_NAME = "frames.csv"
# A looped recording continues from its last time, and the wire format holds 64 bits
# (`recording`).
T_NS_MAX = 2**62
# 9.7 h at 60 frames/s.
ROWS_MAX = 1 << 21
# Far above the rounding of printed digits, far below columns in another order.
UNIT_TOLERANCE = 1e-3
# As in the wire format.
ERROR_US_MAX = 2**32 - 1
_HEADERS: Final = [HEADER + MORE[:count] for count in range(len(MORE) + 1)]
# A file without line ends must not become one line in memory.
_LINE_BYTES_MAX: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class TableRow:
    """One line of the table; `pose_error_us` is the greatest time between the pose and `t_ns`."""

    image: str
    t_ns: int
    pose: Pose | None
    pose_error_us: int = 0


class FrameTable(Sequence[TableRow]):
    """The rows of a table, kept as its lines: one `TableRow` object each would take three times the
    memory.
    """

    def __init__(self) -> None:
        self.damaged = self.zero_bytes = 0
        self.first_damaged = ""
        self.damaged_by = ""
        self.suspected = ""
        self._lines: list[bytes] = []

    def append(self, line: bytes) -> None:
        """Append a line that `read_table` has checked."""
        self._lines.append(line)

    def leave_out(self, where: str, line: bytes) -> None:
        """Count a line whose checksum is wrong."""
        self.damaged += 1
        if not self.first_damaged:
            self.first_damaged, self.damaged_by = where, _rounded(line)

    @property
    def damage(self) -> str:
        """A line for a person about the lines left out, and about times that no camera has; empty
        if all is well.
        """
        found = [self.suspected] if self.suspected else []
        if self.damaged:
            why = (
                f"found {counted(self.zero_bytes, 'zero byte')}, as after a power cut"
                if self.zero_bytes
                else "the checksums do not match"
            )
            text = (
                f"{self.first_damaged}: left out {counted(self.damaged, 'damaged line')} and their "
                f"frames, because {why}"
            )
            found.insert(0, f"{text}; {self.damaged_by}" if self.damaged_by else text)
        return "; ".join(found)

    def __len__(self) -> int:
        """The number of rows."""
        return len(self._lines)

    def __getitem__(self, index: Any) -> Any:
        """One row, or a list of rows for a slice."""
        # Without a place in the file: they were checked when they were read.
        lines = self._lines[index]
        return (
            _row("", _cells("", lines))
            if isinstance(lines, bytes)
            else [_row("", _cells("", x)) for x in lines]
        )


def table_in(folder: Path) -> Path | None:
    """The path of a folder's table of frames, or of the ``.part`` that a crashed writer left;
    None without either.
    """
    table = folder / TABLE_NAME
    return next((path for path in (table, part(table)) if path.exists()), None)


def line_crc32(columns: str) -> str:
    """The last cell of a line: zlib's CRC-32 of everything before its last comma,
    in eight hexadecimal digits.
    """
    return f"{zlib.crc32(columns.encode()):08x}"


def read_table(path: Path, *, cut_off: bool = False) -> FrameTable:
    """Read frames.csv.

    Lines with a wrong ``crc32`` are left out and counted; with `cut_off`, its writer crashed, so an
    unterminated last line is left out. Raises ConfigError for a mistake, times that do not
    increase, or no row.
    """
    rows, last_ns, header, numbered = FrameTable(), -1, list[str](), False
    try:
        with open_regular(path, ROWS_MAX * BYTES_A_ROW_MAX) as stream:
            for count, line in enumerate(iter(lambda: stream.readline(_LINE_BYTES_MAX), b""), 1):
                where = f"{path}:{count}"
                # A power cut leaves zero bytes where a file's end was not yet on the disk.
                rows.zero_bytes += line.count(b"\0")
                if cut_off and not line.endswith(b"\n"):
                    break
                if numbered:
                    line = line.partition(b",")[2]
                # Before the cells are parsed: a damaged number may look like another one.
                columns, _, crc32 = line.rstrip(b"\r\n").rpartition(b",")
                if header and header[-1] == CRC_COLUMN and crc32 != b"%08x" % zlib.crc32(columns):
                    rows.leave_out(where, line)
                    continue
                if not (cells := _cells(where, line)):
                    continue
                if not header:
                    numbered = is_row_numbers(cells[0])
                    header = _known_header(where, cells[numbered:])
                    continue
                if len(cells) != len(header):
                    raise ConfigError(
                        f"{where}: found {len(cells)} columns, expected {len(header)}"
                    )
                if (row := _row(where, cells)).t_ns <= last_ns:
                    raise ConfigError(
                        f"{where}: t_ns: found {row.t_ns}, "
                        f"expected more than the previous row's {last_ns}"
                    )
                if len(rows) == ROWS_MAX:
                    raise ConfigError(
                        f"{where}: found more than {ROWS_MAX} rows, expected at most {ROWS_MAX}"
                    )
                rows.append(line)
                last_ns = row.t_ns
    except OSError as error:
        raise ConfigError(
            f"{shown(path)}: {error.strerror or error}, expected a CSV file of frames"
        ) from None
    _judge(path, rows)
    return rows


def _judge(path: Path, rows: FrameTable) -> None:
    """Note times that no camera has. Raises ConfigError without a row."""
    if not rows:
        if rows.damaged and not rows.damaged_by:
            rows.damaged_by = str(suspicion(SuspicionCode.TABLE_EDITED))
        damage = f" ({rows.damage})" if rows.damage else ""
        raise ConfigError(f"{path}: found no rows, expected one per frame{damage}")
    first = rows[: STEPS_JUDGED + 1]
    if found := judge_steps([after.t_ns - before.t_ns for before, after in pairwise(first)]):
        # The frames are as good as ever: only what needs their times is wrong.
        rows.suspected = f"{path}: {found}"


def _rounded(line: bytes) -> str:
    """What a damaged line's time seems to be; empty if it is a whole number, or no number."""
    name_and_time = line.split(b",", 2)[:2]
    cell = name_and_time[-1].decode(errors="replace").strip(' "\r\n')
    found = judge_time_cell(cell) if len(name_and_time) > 1 else None
    return "" if found is None else str(found)


def _known_header(where: str, cells: list[str]) -> list[str]:
    if tuple(cells) not in _HEADERS:
        found = f"found the header {shown(','.join(cells), 80)}"
        raise ConfigError(f"{where}: {found}, expected {','.join(_HEADERS[-1])}")
    return cells


def _cells(where: str, line: bytes) -> list[str]:
    """The cells of a line, none of which may hold a line's end. Raises ConfigError."""
    # Spreadsheets begin a file with a byte order mark.
    try:
        return next(csv.reader((line.decode("utf-8-sig"),), strict=True, skipinitialspace=True), [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{where}: not a CSV file: {error}") from None


def _row(where: str, cells: list[str]) -> TableRow:
    name, time, *pose = cells[: len(HEADER)]
    error = "".join(cells[len(HEADER) : len(HEADER) + 1])
    if not name:
        raise ConfigError(
            f"{where}: image: found nothing, expected a file name or the number of a video frame"
        )
    if not _whole(time, T_NS_MAX):
        if found := judge_time_cell(time):
            raise ConfigError(f"{where}: {found}")
        raise ConfigError(
            f"{where}: t_ns: found {quoted(time)}, expected a whole number from 0 to 2^62"
        )
    empty = [text == "" for text in pose]
    if error and (all(empty) or not _whole(error, ERROR_US_MAX)):
        expected = "a whole number from 0 to 2^32 - 1 in a row with a pose, or nothing"
        raise ConfigError(f"{where}: {ERROR_COLUMN}: found {quoted(error)}, expected {expected}")
    if all(empty):
        return TableRow(name, int(time), None)
    if any(empty):
        raise ConfigError(
            f"{where}: x_mm to qz: found {7 - sum(empty)} of the 7 values, expected all or none"
        )
    # Spreadsheets quote a number with a decimal comma.
    if not any("." in cell for cell in pose):
        pose = [cell.replace(",", ".") for cell in pose]
    return TableRow(
        name, int(time), Pose(int(time), *_seven(where, pose, UNIT_TOLERANCE)), int(error or "0")
    )


def _whole(text: str, most: int) -> bool:
    # isdecimal alone also takes other scripts' digits, and int() refuses thousands of them with an
    # error of its own.
    return text.isascii() and text.isdecimal() and len(text) < 20 and int(text) <= most


def _seven(where: str, cells: Sequence[str], tolerance: float) -> list[float]:
    """A pose's values. Raises ConfigError."""
    values = [number(where, column, text) for column, text in zip(_POSE, cells, strict=True)]
    if abs((norm := math.hypot(*values[3:])) - 1) > tolerance:
        raise ConfigError(
            f"{where}: qw, qx, qy, qz: found a quaternion of length {norm:.4g}, expected length 1"
        )
    return values


POSES_HEADER = ("image", *_POSE)
POSES_MAX = 100_000
# People and robots' programs write this table, with few digits.
_POSES_UNIT = 0.01


@dataclass(frozen=True, slots=True)
class PosedImage:
    """A line of the table; `where` is ``FILE:LINE``."""

    where: str
    path: Path
    base_T_flange: Rigid


def read_poses(path: Path) -> list[PosedImage]:
    """Read the table but not its images, whose paths are relative to it.

    Raises ConfigError for a mistake or no row.
    """
    rows, unknown = read_columns(path, POSES_HEADER, (), "poses", rows_max=POSES_MAX)
    if unknown:
        raise ConfigError(
            f"{path}:1: {unknown[0]}: found an unknown column, expected {','.join(POSES_HEADER)}"
        )
    if not rows:
        raise ConfigError(f"{path}: found no rows, expected one per image")
    posed = []
    for where, row in rows:
        if not row["image"]:
            raise ConfigError(f"{where}: image: found nothing, expected a file name")
        values = _seven(where, [row[column] for column in _POSE], _POSES_UNIT)
        posed.append(PosedImage(where, named_file(path.parent, row["image"]), from_seven(values)))
    return posed
