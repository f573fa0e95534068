"""Writes a recording with its frames in MCAP files and all other files as `recorder` writes them; fixes such files."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.atomic_files import FREE_FLOOR_BYTES, disk_errors, part, sync
from tacshade_edge.storage.recording.mcap import require_mcap
from tacshade_edge.storage.recording.recorder import Recorder
from tacshade_edge.storage.recording.recording_content import CALIBRATION_NAME, SETTINGS_NAME
from tacshade_edge.types import Frame

if TYPE_CHECKING:
    from tacshade_edge.storage.recording.mcap.writer import McapWriter

_log = logging.getLogger(__name__)
_UNFINISHED: Final = ".mcap.part"
FILE_BYTES_MAX: Final = 512 << 20
FILE_NS_MAX: Final = 300 * 1_000_000_000
"""Limits of one file, because its index stays in memory until its end, at 0.7 kB per frame."""
_CHUNK_BYTES: Final = 16 << 10
"""A chunk ends when it exceeds this size, as any picture does, so truncation loses only a frame or two."""


class McapRecorder(Recorder):
    """One recording in a new folder as ``000.mcap``, ``001.mcap`` ...; each is readable alone and grows as ``.part``.

    `sensor_id` names the topics.
    """

    def __init__(self, folder: Path, sensor_id: str, *, free_floor_bytes: int = FREE_FLOOR_BYTES) -> None:
        require_mcap()
        from tacshade_edge.storage.recording.mcap.writer import McapWriter

        super().__init__(folder, free_floor_bytes=free_floor_bytes)
        # PNG cannot be compressed further.
        self._make = partial(McapWriter, sensor_id=sensor_id, chunk_bytes=_CHUNK_BYTES, compress=False)
        self._files = 0
        self._open: tuple[BinaryIO, McapWriter] | None = None
        self._torn = False
        self._begun_ns = 0
        self._path = folder

    def _begin_frames(self) -> None:
        """Write no table: the MCAP files hold the times and poses."""

    def add(self, frame: Frame, png: bytes) -> bool:
        """Write a frame with its image `png`; write nothing and return False if the disk is down to the floor."""
        with disk_errors(self.folder):
            if shutil.disk_usage(self.folder).free < self._floor:
                return False
            try:
                stream, writer = self._file_for(frame)
                writer.frame(f"{self.frames:06d}.png", frame, png, frame.wall_ns)
                stream.flush()
            except OSError:
                self._torn = True
                raise
            self.frames += 1
            self.bytes += len(png)
        return True

    def sync(self) -> None:
        """Wait until everything written is on the disk."""
        super().sync()
        if self._open is not None and not self._torn:
            with disk_errors(self.folder):
                os.fsync(self._open[0].fileno())

    def finish(self, about: Mapping[str, object]) -> None:
        """Complete the recording and write ``recording.json``."""
        with disk_errors(self.folder):
            self._end_file()
        super().finish(about)

    def close(self) -> None:
        """Close the files of an unfinished recording."""
        super().close()
        if self._open is not None:
            self._leave_torn(self._open[0])

    def _file_for(self, frame: Frame) -> tuple[BinaryIO, McapWriter]:
        """The file for this frame: the open one, or a new one if that is full."""
        if self._open is not None and (
            self._open[0].tell() > FILE_BYTES_MAX or frame.t_ns - self._begun_ns > FILE_NS_MAX
        ):
            self._end_file()
        if self._open is None:
            self._open = self._begin_file(frame)
        return self._open

    def _begin_file(self, frame: Frame) -> tuple[BinaryIO, McapWriter]:
        self._path = self.folder / f"{self._files:03d}.mcap"
        self._files += 1
        self._begun_ns = frame.t_ns
        stream = part(self._path).open("wb")
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)  # keeps `fix` away from it
        writer = self._make(stream)
        for name in (CALIBRATION_NAME, SETTINGS_NAME):
            writer.attach(name, (self.folder / name).read_bytes(), frame.wall_ns)
        sync(self.folder)
        return stream, writer

    def _end_file(self) -> None:
        if self._open is None:
            return
        stream, writer = self._open
        if self._torn:
            self._leave_torn(stream)
            fix(part(self._path))
            return
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
        part(self._path).rename(self._path)
        sync(self.folder)
        stream.close()
        self._open = None

    def _leave_torn(self, stream: BinaryIO) -> None:
        """Close a file after an incomplete record, which must stay the last one in it."""
        with contextlib.suppress(OSError):  # flushing the buffer may fail, too
            stream.close()
        self._open = None


def fix_recordings(folder: Path) -> list[Path]:
    """After a crash, end every MCAP file below `folder` that nobody is writing behind its last whole record.

    Returns their new names. Raises DeviceError if the disk fails; files not yet fixed are unchanged.
    """
    if not (unfinished := sorted(folder.glob(f"*/*{_UNFINISHED}"))):
        return []
    try:
        require_mcap()
        return [path for path in map(fix, unfinished) if path is not None]
    except ConfigError as error:
        _log.warning("%s: cannot repair the recording: %s", unfinished[0], error)
        return []
    except OSError as error:
        where = error.filename or folder
        text = f"{where}: cannot repair the recording: {error.strerror or error}"
        raise DeviceError(text, code=ReasonCode.DISK) from None


def fix(path: Path) -> Path | None:
    """Turn ``NAME.mcap.part`` into ``NAME.mcap``; None if somebody writes it or it has no header. Raises OSError."""
    from mcap.opcode import Opcode

    from tacshade_edge.storage.recording.mcap.reader import HEAD, MAGIC, McapFile, Place

    with path.open("r+b") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            places = McapFile(path, stream).places()  # past any damage, which readers will report
        except (BlockingIOError, ConfigError):
            return None
        if (end := max((place.end for place in places if isinstance(place, Place)), default=None)) is None:
            return None
        stream.truncate(end)
        stream.seek(end)
        # The end of a data section without a checksum, and no summary, so readers scan the file.
        stream.write(HEAD.pack(Opcode.DATA_END, 4) + bytes(4) + HEAD.pack(Opcode.FOOTER, 20) + bytes(20) + MAGIC)
        stream.flush()
        os.fsync(stream.fileno())
        whole = path.with_name(path.name.removesuffix(".part"))
        path.rename(whole)
        sync(path.parent)
    return whole
