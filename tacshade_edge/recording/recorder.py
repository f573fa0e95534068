"""Writes a recording for `recording.recording`: PNG frames, their table, events, settings
and calibration.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import BinaryIO, Final

import cv2

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.atomic_files import (
    disk_errors,
    is_nearly_full,
    part,
    require_free,
    sync,
    write_whole,
)
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.recording.frame_table import HEADER, MORE, TABLE_NAME, line_crc32
from tacshade_edge.recording.recording_content import (
    ABOUT_NAME,
    CALIBRATION_NAME,
    EVENTS_BYTES_MAX,
    EVENTS_NAME,
    SETTINGS_NAME,
)
from tacshade_edge.types import U8, Frame

# Lossless; for grey images 2.5 times as fast as zlib's level 1 and no larger
# (docs/how-to/replay.md).
_PNG_OPTIONS: Final = {
    cv2.IMWRITE_PNG_COMPRESSION: 1,
    cv2.IMWRITE_PNG_STRATEGY: cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
    cv2.IMWRITE_PNG_FILTER: cv2.IMWRITE_PNG_FILTER_UP,
}
PNG_OPTIONS: Final = tuple(chain.from_iterable(_PNG_OPTIONS.items()))


def png_of(image: U8) -> bytes:
    """Encode a frame's image as PNG for `Recorder.add`."""
    return cv2.imencode(".png", image, PNG_OPTIONS)[1].tobytes()


class RecordingWriter:
    """One recording in a new folder, made at once; call `begin` first.

    The table and the events grow as ``.part``, a whole line at a time, after the file that it
    names; after a crash `recording.recording` reads them. Raises ConfigError if the folder
    exists, and DeviceError, as the methods do, if it cannot be written or the disk is down to the
    floor.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.frames = self.bytes = self._events_bytes = 0
        self._unsynced: list[Path] = []
        self._lines: dict[str, BinaryIO] = {}
        with disk_errors(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            require_free(folder.parent)
            try:
                folder.mkdir()
            except FileExistsError:
                raise ConfigError(
                    f"{folder}: already exists, expected the name of a new folder",
                    code=ReasonCode.NAME_TAKEN,
                ) from None

    def begin(self, settings_yaml: str, calibration: bytes) -> None:
        """Write the calibration's file and the settings, which a replay needs,
        and open the events and the table.
        """
        # Before any frame: a replay of a torn recording needs both.
        with disk_errors(self.folder):
            write_whole(self.folder / CALIBRATION_NAME, calibration)
            write_whole(self.folder / SETTINGS_NAME, settings_yaml.encode())
            # Unbuffered: a line reaches the kernel whole, so that a dying process tears none.
            self._lines[EVENTS_NAME] = part(self.folder / EVENTS_NAME).open("wb", buffering=0)
            # Until the recording is whole or the process ends: the dashboard leaves a locked one
            # alone, however long no frame comes.
            fcntl.flock(self._lines[EVENTS_NAME], fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._lines[TABLE_NAME] = part(self.folder / TABLE_NAME).open("wb", buffering=0)
            self._line(TABLE_NAME, ",".join((*HEADER, *MORE)))
            sync(self.folder)
            sync(self.folder.parent)

    def add(self, frame: Frame, png: bytes) -> bool:
        """Write a frame with its image `png`; write nothing and return False if the disk is down
        to the floor.
        """
        with disk_errors(self.folder):
            # A full disk harms more than this recording.
            if is_nearly_full(self.folder):
                return False
            self._write(f"{self.frames:06d}.png", frame, png)
        self.frames += 1
        self.bytes += len(png)
        return True

    def _write(self, name: str, frame: Frame, png: bytes) -> None:
        # The picture first: no line may name a file that is not there.
        write_whole(self.folder / name, png, sync=False)
        self._unsynced.append(self.folder / name)
        columns = f"{name},{frame.t_ns},{_columns(frame)}"
        self._line(TABLE_NAME, f"{columns},{line_crc32(columns)}")

    def event(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Write an event; `t_ns` is on the frames' clock.

        Raises DeviceError, too, if there would be more than a replay reads.
        """
        text = json.dumps({"t_ns": t_ns, "kind": kind, "data": data})
        if self._events_bytes + len(text) >= EVENTS_BYTES_MAX:  # ASCII, and the line's end
            raise DeviceError(
                f"the events fill {EVENTS_BYTES_MAX >> 20} MiB, and no replay reads more",
                code=ReasonCode.RECORDING_FULL,
            )
        with disk_errors(self.folder):
            self._line(EVENTS_NAME, text)
        self._events_bytes += len(text) + 1

    def _line(self, name: str, text: str) -> None:
        data = f"{text}\n".encode()
        # A disk that fills up takes a part of a line, and only the next write would report it.
        if self._lines[name].write(data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), self.folder / name)

    def sync(self) -> None:
        """Wait until everything written is on the disk;
        syncing each frame alone would cost too much.
        """
        with disk_errors(self.folder):
            # In the same order, for a power cut.
            for path in self._unsynced:
                sync(path)
            self._unsynced.clear()
            for stream in self._lines.values():
                os.fsync(stream.fileno())
            sync(self.folder)

    def finish(self, about: Mapping[str, object]) -> None:
        """Complete the recording and write ``recording.json``."""
        self.sync()
        with disk_errors(self.folder):
            for name in self._lines:
                os.replace(part(self.folder / name), self.folder / name)
            # Last: with it, the recording is whole.
            write_whole(self.folder / ABOUT_NAME, (json.dumps(about, indent=2) + "\n").encode())
            sync(self.folder)
        self.close()

    def close(self) -> None:
        """Close the files of an unfinished recording."""
        for stream in self._lines.values():
            stream.close()


def _columns(frame: Frame) -> str:
    if (pose := frame.pose) is None:
        return ",,,,,,,"
    # repr gives the same number again: a replay must publish the same bytes.
    values = (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz)
    return ",".join((*(repr(float(v)) for v in values), str(frame.pose_error_us)))
