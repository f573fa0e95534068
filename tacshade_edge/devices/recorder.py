"""Writes a recording that `devices.recording` reads: PNG frames, their table, and what made them beside it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import cv2

from tacshade_edge.devices.recording import HEADER, TABLE_NAME
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.types import Frame

# A full disk harms more than this recording.
FREE_FLOOR_BYTES = 256 * 2**20
# Fast rather than small: a level more costs frames on a small board.
PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 1)
TABLE_EVERY_FRAMES = 60


class Recorder:
    """One recording in one new folder; every file is written beside its place and renamed.

    The table is written anew every 60 frames and by `finish`: after a crash it names whole images only.

    Parameters
    ----------
    folder : Path
    free_floor_bytes : int
        `add` refuses to begin a frame with less than this free on the disk.

    Raises
    ------
    ConfigError
        The folder has a recording, or images, already.
    DeviceError
        It cannot be written; from the methods too.
    """

    def __init__(self, folder: Path, *, free_floor_bytes: int = FREE_FLOOR_BYTES) -> None:
        self._folder = folder
        self._floor = free_floor_bytes
        self._rows: list[str] = []
        with self._told():
            folder.mkdir(parents=True, exist_ok=True)
            if (found := next(folder.iterdir(), None)) is not None:
                raise ConfigError(f"{folder}: found {found.name} in it, expected a new or empty folder")

    @property
    def frames(self) -> int:
        """Frames written."""
        return len(self._rows)

    def copy(self, source: Path, name: str) -> None:
        """Put a copy of a file into the folder."""
        with self._told():
            self._write(name, source.read_bytes())

    def add(self, frame: Frame) -> bool:
        """Write a frame; False, and nothing written, when the disk is down to the floor."""
        with self._told():
            if shutil.disk_usage(self._folder).free < self._floor:
                return False
            name = f"{len(self._rows):06d}.png"
            _, png = cv2.imencode(".png", frame.image, PNG_OPTIONS)
            self._write(name, png.tobytes())
            self._rows.append(f"{name},{frame.t_ns}" + "," * (len(HEADER) - 2) + "\n")
            if len(self._rows) % TABLE_EVERY_FRAMES == 1:
                self._write_table()
        return True

    def finish(self, about: Mapping[str, object]) -> None:
        """Write the table and ``recording.json``."""
        with self._told():
            self._write_table()
            self._write("recording.json", (json.dumps(about, indent=2) + "\n").encode())

    def _write_table(self) -> None:
        self._write(TABLE_NAME, (",".join(HEADER) + "\n" + "".join(self._rows)).encode())

    def _write(self, name: str, data: bytes) -> None:
        partial = self._folder / (name + ".part")
        try:
            partial.write_bytes(data)
            os.replace(partial, self._folder / name)
        except OSError:
            partial.unlink(missing_ok=True)
            raise

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            where = error.filename or self._folder
            raise DeviceError(f"{where}: cannot be written: {error.strerror or error}") from None
