"""A stitching session on disk: what was acknowledged is there after a kill or a power cut.

A folder has ``session.json`` (written whole, by renaming) and ``presses.bin``, to which every press is appended and
brought to the disk before it is acknowledged. A press that was cut by a crash is cut off at the next start.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np

from tacshade_edge.core.stitching.press_points import PressPoints
from tacshade_edge.devices.files.whole_files import disk_errors, sync, write_whole
from tacshade_edge.errors import DecodeError
from tacshade_edge.rigid import Rigid

SESSION, PRESSES = "session.json", "presses.bin"
VERSION = 1
_HEAD = struct.Struct("<4sII")  # magic, bytes and CRC-32 of what follows
_MAGIC = b"TCSP"
_POSE_VALUES, _POINT_VALUES = 12, 7
_PRESS_POINTS_MAX = 1_000_000


@dataclass(frozen=True, slots=True)
class SessionInfo:
    """What ``session.json`` holds.

    Attributes
    ----------
    name : str
    begun_wall_ns : int
        Unix time.
    calibration_crc32 : int
        Of the calibration that it began with.
    skin_radius_mm : float
    state : str
        ``open``, or ``ended``.
    version : int
    """

    name: str
    begun_wall_ns: int
    calibration_crc32: int
    skin_radius_mm: float
    state: Literal["open", "ended"] = "open"
    version: int = VERSION


class StitchFile:
    """An open session's files.

    Parameters
    ----------
    folder : Path
    info : SessionInfo

    Raises
    ------
    DeviceError
        The folder cannot be written; from the methods too.
    """

    def __init__(self, folder: Path, info: SessionInfo) -> None:
        self.folder = folder
        self.info = info
        self._stream: BinaryIO | None = None
        self._end = 0  # of the last whole press

    @classmethod
    def create(cls, folder: Path, info: SessionInfo) -> StitchFile:
        """Begin a session in a folder that has none."""
        with disk_errors(folder):
            folder.mkdir(parents=True)
            (folder / PRESSES).touch(exist_ok=False)
            write_whole(folder / SESSION, _json(info))
            sync(folder)
            sync(folder.parent)
        return cls(folder, info)

    @classmethod
    def resume(cls, folder: Path) -> tuple[StitchFile, list[tuple[PressPoints, Rigid]]]:
        """Go on with a session: its presses, those that are whole, in order.

        Raises
        ------
        DecodeError
            ``session.json`` is damaged or of another version.
        """
        info = read_info(folder)
        presses: list[tuple[PressPoints, Rigid]] = []
        with disk_errors(folder), (folder / PRESSES).open("r+b") as stream:
            end = 0
            for points, pose, end in _presses(stream):  # noqa: B007 (the last one counts)
                presses.append((points, pose))
            stream.truncate(end)
            os.fsync(stream.fileno())
        file = cls(folder, info)
        file._end = end
        return file, presses

    def append(self, points: PressPoints, base_T_sensor: Rigid) -> None:
        """Add a press; it is on the disk when this returns."""
        pose = np.concatenate((base_T_sensor.rotation.ravel(), base_T_sensor.translation_mm))
        columns = np.column_stack((points.points_mm, points.normals, points.confidence)).astype("<f4")
        body = pose.astype("<f8").tobytes() + columns.tobytes()
        record = _HEAD.pack(_MAGIC, len(body), zlib.crc32(body)) + body
        with disk_errors(self.folder):
            if self._stream is None:
                self._stream = (self.folder / PRESSES).open("r+b", buffering=0)
            # Over what a write that failed left behind.
            self._stream.seek(self._end)
            self._stream.truncate()
            self._stream.write(record)
            os.fsync(self._stream.fileno())
        self._end += len(record)

    def end(self) -> None:
        """Mark the session as ended; its presses stay."""
        self.close()
        self.info = replace(self.info, state="ended")
        with disk_errors(self.folder):
            write_whole(self.folder / SESSION, _json(self.info))

    def remove(self) -> None:
        """Delete the session's files, and the folder if nothing else is in it."""
        self.close()
        with disk_errors(self.folder):
            # Without session.json it is no session, whatever a crash leaves of the rest.
            (self.folder / SESSION).unlink(missing_ok=True)
            (self.folder / PRESSES).unlink(missing_ok=True)
            if not any(self.folder.iterdir()):
                self.folder.rmdir()

    def close(self) -> None:
        """Close the file; `append` opens it again."""
        if self._stream is not None:
            with disk_errors(self.folder):
                self._stream.close()
            self._stream = None


def open_session(folder: Path) -> Path | None:
    """Find the session below a folder that was not ended: the newest, or None. Damaged ones are passed over."""
    found = []
    for path in sorted(folder.glob(f"*/{SESSION}")):
        try:
            info = read_info(path.parent)
        except DecodeError:
            continue
        if info.state == "open":
            found.append((info.begun_wall_ns, path.parent))
    return max(found)[1] if found else None


def read_info(folder: Path) -> SessionInfo:
    """Read ``session.json``.

    Raises
    ------
    DecodeError
        Not readable, damaged, or of another version.
    """
    path = folder / SESSION
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        info = SessionInfo(**values)
    except OSError as error:
        raise DecodeError(f"{path}: {error.strerror or error}, expected a stitching session") from None
    except (ValueError, TypeError) as error:
        raise DecodeError(f"{path}: {error}, expected a stitching session") from None
    if info.version != VERSION:
        raise DecodeError(f"{path}: found version {info.version}, expected {VERSION}")
    return info


def _json(info: SessionInfo) -> bytes:
    return (json.dumps(asdict(info), indent=2) + "\n").encode()


def _presses(stream: BinaryIO) -> Iterator[tuple[PressPoints, Rigid, int]]:
    """Every whole press from the start, and where it ends; stops before the first that is not."""
    while len(head := stream.read(_HEAD.size)) == _HEAD.size:
        magic, size, crc32 = _HEAD.unpack(head)
        rest = size - 8 * _POSE_VALUES
        if magic != _MAGIC or not 0 <= rest <= 4 * _POINT_VALUES * _PRESS_POINTS_MAX or rest % (4 * _POINT_VALUES):
            return
        body = stream.read(size)
        if len(body) < size or zlib.crc32(body) != crc32:
            return
        pose = np.frombuffer(body, "<f8", _POSE_VALUES).astype(np.float64)
        columns = np.frombuffer(body, "<f4", offset=8 * _POSE_VALUES).reshape(-1, _POINT_VALUES).astype(np.float32)
        points_mm, normals, confidence = (
            np.ascontiguousarray(part) for part in (columns[:, :3], columns[:, 3:6], columns[:, 6])
        )
        yield PressPoints(points_mm, normals, confidence), Rigid(pose[:9].reshape(3, 3), pose[9:]), stream.tell()
