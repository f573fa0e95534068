"""A stitching session on disk: acknowledged presses survive a kill or a power cut.

A folder has ``session.json`` (written whole, by renaming) and ``presses.bin``, to which every press
is appended and synced before it is acknowledged. Both have checksums. If ``presses.bin`` is damaged
or a crash truncated its last press, a copy of the damaged file is kept, and the session keeps every
whole press, including those after the damage.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import mmap
import os
import shutil
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, BinaryIO, Literal

import msgspec
import numpy as np
from msgspec import Meta

from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.files.atomic_files import disk_errors, require_free, sync, write_whole
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.regular_files import open_regular, read_regular
from tacshade_edge.rigid import Rigid
from tacshade_edge.stitching.press_points import PressPoints

_log = logging.getLogger(__name__)

SESSION, PRESSES = "session.json", "presses.bin"
VERSION = 2
"""Version 1, without `sensor_id` and `crc32`, is still readable."""
_CHECKED_SINCE = 2
_HEAD = struct.Struct("<4sII")  # magic, bytes and CRC-32 of what follows
_MAGIC = b"TCSP"
_POSE_VALUES, _POINT_VALUES = 12, 7
_PRESS_POINTS_MAX = 1_000_000
# The daemon reads whatever lies in the folder, and must not run out of memory by it.
_INFO_BYTES_MAX, _PRESSES_BYTES_MAX = 64 * 2**10, 2**30
_MOST_MM = 1e6

_Crc32 = Annotated[int, Meta(ge=0, lt=2**32)]


class SessionInfo(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``session.json``; `crc32`, in the file only, is that of the other fields as
    compact JSON. `sensor_id` is empty in version 1; the calibration is the one with which the
    session began; `skin_radius_mm` is 0 for a pad.
    """

    name: Annotated[str, Meta(min_length=1, max_length=64)]
    begun_wall_ns: Annotated[int, Meta(ge=0)]
    calibration_crc32: _Crc32
    skin_radius_mm: Annotated[float, Meta(ge=0, lt=_MOST_MM)]
    sensor_id: str = ""
    state: Literal["open", "ended"] = "open"
    version: int = VERSION
    crc32: _Crc32 = 0


class StitchFile:
    """An open session's files; the methods raise DeviceError if the folder cannot be written."""

    def __init__(self, folder: Path, info: SessionInfo) -> None:
        self.folder = folder
        self.info = info
        self._stream: BinaryIO | None = None
        self._end = self._before = 0  # the ends of the last whole press and of the one before

    @classmethod
    def create(cls, folder: Path, info: SessionInfo) -> StitchFile:
        """Begin a session in a new folder; a failure leaves nothing behind."""
        with disk_errors(folder):
            require_free(folder.parent)
            folder.mkdir(parents=True)
            file = cls(folder, info)
            try:
                (folder / PRESSES).touch(exist_ok=False)
                write_whole(folder / SESSION, _json(info))
                # Files survive a power cut by their folder's sync, the folder by its parent's.
                sync(folder)
                sync(folder.parent)
            except OSError:
                with contextlib.suppress(DeviceError):
                    file.remove()
                raise
        return file

    @classmethod
    def resume(cls, folder: Path) -> tuple[StitchFile, list[tuple[PressPoints, Rigid]]]:
        """Resume a session: its file and whole presses in order.

        Raises DecodeError if ``session.json`` is unusable.
        """
        file = cls(folder, read_info(folder))
        path = folder / PRESSES
        with disk_errors(folder):
            with open_regular(path, _PRESSES_BYTES_MAX) as stream:
                size = os.fstat(stream.fileno()).st_size
                data = mmap.mmap(stream.fileno(), size, access=mmap.ACCESS_READ) if size else b""
            found = list(_presses(data))
            file._end = sum(end - start for _, _, start, end in found)
            if lost := len(data) - file._end:
                names = (path.with_name(f"{path.name}.damaged-{k}") for k in itertools.count(1))
                # A copy stays, since the damage may hold more presses than this program finds.
                beside = next(name for name in names if not name.exists())
                shutil.copyfile(path, beside)
                sync(beside)
                write_whole(path, b"".join(data[start:end] for _, _, start, end in found))
                sync(folder)
                kept = (
                    f"continuing with {len(found)} whole presses and keeping the old file as "
                    f"{beside.name}"
                )
                _log.warning("%s: %d bytes are damaged or incomplete; %s", path, lost, kept)
        return file, [(points, pose) for points, pose, _, _ in found]

    @property
    def gone(self) -> bool:
        """Whether somebody has deleted the session."""
        return not os.path.lexists(self.folder / SESSION)

    def append(self, points: PressPoints, base_T_sensor: Rigid) -> None:
        """Append a press; it is on the disk when this returns."""
        pose = np.concatenate((base_T_sensor.rotation.ravel(), base_T_sensor.translation_mm))
        columns = np.column_stack((points.points_mm, points.normals, points.confidence)).astype(
            "<f4"
        )
        body = pose.astype("<f8").tobytes() + columns.tobytes()
        record = _HEAD.pack(_MAGIC, len(body), zlib.crc32(body)) + body
        with disk_errors(self.folder):
            # The stream may still be open on an unlinked file, and would take presses that nobody
            # finds again.
            if self.gone:
                raise DeviceError(
                    f"{self.folder}: the session's files are gone", code=ReasonCode.DISK
                )
            require_free(self.folder)
            if self._stream is None:
                self._stream = (self.folder / PRESSES).open("r+b", buffering=0)
            # Overwrite the remains of a failed write.
            self._stream.seek(self._end)
            self._stream.truncate()
            written = self._stream.write(record)
            # Unbuffered, so that no part of a press waits in this process: a full disk shows as a
            # write of a part, and only the next one would report it.
            if written < len(record):
                raise DeviceError(
                    f"{self.folder}: cannot write it: the disk is full", code=ReasonCode.DISK_FULL
                )
            os.fsync(self._stream.fileno())
        self._before, self._end = self._end, self._end + len(record)

    def take_back(self) -> None:
        """Remove the press that `append` has just added, before anyone has seen it."""
        assert self._stream is not None
        self._end = self._before
        with disk_errors(self.folder):
            self._stream.truncate(self._end)

    def end(self) -> None:
        """Mark the session as ended; its presses stay."""
        self.close()
        self.info = msgspec.structs.replace(self.info, state="ended")
        with disk_errors(self.folder):
            write_whole(self.folder / SESSION, _json(self.info))

    def remove(self) -> None:
        """Delete the session's files, and the folder if it is then empty;
        do nothing if it is gone already.
        """
        self.close()
        if not self.folder.exists():
            return
        with disk_errors(self.folder):
            # Without session.json the folder is no session, whatever else a crash leaves.
            (self.folder / SESSION).unlink(missing_ok=True)
            sync(self.folder)
            (self.folder / PRESSES).unlink(missing_ok=True)
            if not any(self.folder.iterdir()):
                self.folder.rmdir()

    def close(self) -> None:
        """Close the file; `append` opens it again."""
        if self._stream is not None:
            with disk_errors(self.folder):
                self._stream.close()
            self._stream = None


def open_session(folder: Path, sensor_id: str) -> Path | None:
    """The newest open session of a sensor below a folder; None without one.

    The log names damaged sessions.
    """
    found = []
    for path in sorted(folder.glob(f"*/{SESSION}")):
        try:
            info = read_info(path.parent)
        except DecodeError as error:
            _log.warning("skipping a session: %s", error)
            continue
        # Version 1 named no sensor; its sessions belong to the one whose folder it is.
        if info.state == "open" and info.sensor_id in ("", sensor_id):
            found.append((info.begun_wall_ns, path.parent))
    return max(found)[1] if found else None


def read_info(folder: Path) -> SessionInfo:
    """Read ``session.json``.

    Raises DecodeError if it is unreadable, damaged, or of another version.
    """
    path = folder / SESSION
    try:
        info = msgspec.json.decode(read_regular(path, _INFO_BYTES_MAX), type=SessionInfo)
    except OSError as error:
        raise DecodeError(
            f"{path}: {error.strerror or error}, expected a stitching session"
        ) from None
    except (ValueError, RecursionError) as error:  # msgspec raises ValueErrors
        raise DecodeError(f"{path}: {shown(str(error))}, expected a stitching session") from None
    if not 1 <= info.version <= VERSION:
        raise DecodeError(f"{path}: found version {info.version}, expected {VERSION}")
    if info.version >= _CHECKED_SINCE and info.crc32 != _crc32(info):
        raise DecodeError(
            f"{path}: the file is damaged: found checksum {_crc32(info)}, "
            f"expected the stored {info.crc32}"
        )
    return msgspec.structs.replace(info, crc32=0)


def _crc32(info: SessionInfo) -> int:
    return zlib.crc32(msgspec.json.encode(msgspec.structs.replace(info, crc32=0)))


def _json(info: SessionInfo) -> bytes:
    info = msgspec.structs.replace(info, version=VERSION)
    return (
        msgspec.json.format(msgspec.json.encode(msgspec.structs.replace(info, crc32=_crc32(info))))
        + b"\n"
    )


def _presses(data: bytes | mmap.mmap) -> Iterator[tuple[PressPoints, Rigid, int, int]]:
    """Every whole press with its first and end byte."""
    start = data.find(_MAGIC)
    while start >= 0:
        body, press = start + _HEAD.size, None
        if body <= len(data):
            _, size, crc32 = _HEAD.unpack_from(data, start)
            press = _press(data, body, body + size, crc32) if body + size <= len(data) else None
        if press is not None:
            yield (*press, start, body + size)
        start = data.find(_MAGIC, start + 1 if press is None else body + size)


def _press(
    data: bytes | mmap.mmap, start: int, end: int, crc32: int
) -> tuple[PressPoints, Rigid] | None:
    """The press in a body; None if the body is damaged or its values cannot be a press."""
    rest = end - start - 8 * _POSE_VALUES
    if not 0 <= rest <= 4 * _POINT_VALUES * _PRESS_POINTS_MAX or rest % (4 * _POINT_VALUES):
        return None
    body = memoryview(data)[start:end]
    if zlib.crc32(body) != crc32:
        return None
    pose = np.frombuffer(body, "<f8", _POSE_VALUES).astype(np.float64)
    columns = (
        np.frombuffer(body, "<f4", offset=8 * _POSE_VALUES)
        .reshape(-1, _POINT_VALUES)
        .astype(np.float32)
    )
    if not (np.abs(pose) <= _MOST_MM).all() or not (np.abs(columns) <= _MOST_MM).all():
        return None
    parts = (
        np.ascontiguousarray(part) for part in (columns[:, :3], columns[:, 3:6], columns[:, 6])
    )
    return PressPoints(*parts), Rigid(pose[:9].reshape(3, 3), pose[9:])
