"""Exports of a recording as CSV and PLY, and what all exports share; each file appears whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from tacshade_edge.errors import ConfigError
from tacshade_edge.protocol.messages import encode_contact, touch_fields
from tacshade_edge.reasons import ReasonCode, code_of
from tacshade_edge.storage.atomic_files import disk_errors, part, require_free, sync
from tacshade_edge.storage.meshes import ply
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction

POSE_COLUMNS: Final = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


class Export(Protocol):
    """Takes every frame in order, then `finish` or `discard`; the methods raise DeviceError if the disk fails."""

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Add the next frame."""

    def finish(self) -> None:
        """Complete the export and move it to its final name."""

    def discard(self) -> None:
        """Remove an unfinished export; after `finish` do nothing."""


class NewPlace:
    """An unused name and the ``.part`` in which a file or folder grows; a leftover ``.part`` is removed.

    Raises ConfigError if the name exists already, and DeviceError if the disk is nearly full or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        if path.exists():
            found = f"{path}: already exists, expected a new name (--out)"
            raise ConfigError(found, code=ReasonCode.NAME_TAKEN)
        self.path, self.partial = path, part(path)
        with self.writing():
            path.parent.mkdir(parents=True, exist_ok=True)
            self.discard()
        require_free(path.parent)

    def writing(self) -> contextlib.AbstractContextManager[None]:
        """Turn an OSError into a DeviceError."""
        return disk_errors(self.path)

    def take(self) -> None:
        """Wait until the ``.part`` is on the disk, and rename it to the final name."""
        with self.writing():
            for path in (self.partial, *self.partial.rglob("*")):
                sync(path)
            self.partial.rename(self.path)
            sync(self.path.parent)

    def discard(self) -> None:
        """Remove the ``.part``."""
        if self.partial.is_dir():
            shutil.rmtree(self.partial, ignore_errors=True)
        else:
            self.partial.unlink(missing_ok=True)


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """The temporary name of a new file, which gets its final name when the block ends. Raises like `NewPlace`."""
    place = NewPlace(path)
    try:
        with place.writing():
            yield place.partial
        place.take()
    finally:
        place.discard()


def contact_numbers(recorded: RecordedFrame, result: Reconstruction) -> dict[str, Any]:
    """The fields of ``contact`` (docs/reference/mqtt/frames.md) without ``fps``, which only a daemon knows."""
    numbers: dict[str, Any] = json.loads(encode_contact(result, fps=0.0))
    del numbers["fps"]
    numbers["wall_ns"] = recorded.wall_ns  # a recording's results have none, so that equal recordings give equal bytes
    return numbers


def touch_numbers(result: Reconstruction, names: Sequence[str]) -> tuple[list[float | None], list[float | None]]:
    """The named quantities of the touch, and their standard deviations; None if unknown."""
    fields = touch_fields(result.touch)
    values, sigmas = ([(fields[key] or {}).get(name) for name in names] for key in ("touch", "touch_sigma"))
    return values, sigmas


def frame_numbers(recorded: RecordedFrame, result: Reconstruction, touch_names: Sequence[str]) -> dict[str, Any]:
    """A table row: image, times, the numbers of contact and touch, ``base_T_flange``; None for a missing value."""
    values, sigmas = touch_numbers(result, touch_names)
    frame = recorded.frame
    pose = frame.pose
    return {
        "image": recorded.name,
        "valid": int(result.valid),
        "saturated": int(result.saturated),
        **contact_numbers(recorded, result),
        **{f"touch_{name}": value for name, value in zip(touch_names, values, strict=True)},
        **{f"touch_sigma_{name}": value for name, value in zip(touch_names, sigmas, strict=True)},
        "touch_reason_code": code_of(None if result.touch is None else result.touch.reason),
        **{f"flange_{name}": None if pose is None else float(getattr(pose, name)) for name in POSE_COLUMNS},
        "pose_error_us": None if pose is None else frame.pose_error_us,
    }


class CsvExport:
    """A CSV file with a row per frame and empty cells for missing values; `touch_names` are a touch's quantities."""

    def __init__(self, path: Path, touch_names: Sequence[str]) -> None:
        self._touch_names = touch_names
        self._place = NewPlace(path)
        with self._place.writing():
            self._stream = self._place.partial.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._stream, lineterminator="\n")
        self._frames = 0

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write a row."""
        numbers = frame_numbers(recorded, result, self._touch_names)
        with self._place.writing():
            if self._frames == 0:
                self._writer.writerow(numbers)
            self._writer.writerow("" if value is None else value for value in numbers.values())
        self._frames += 1

    def finish(self) -> None:
        """Complete the file and move it to its final name."""
        with self._place.writing():
            self._stream.close()
        self._place.take()

    def discard(self) -> None:
        """Remove the unfinished file."""
        self._stream.close()
        self._place.discard()


class PlyExport:
    """A folder of ``SEQ.ply`` files: points of the skin in contact in mm, sensor frame, with their object's number."""

    def __init__(self, folder: Path) -> None:
        self._place = NewPlace(folder)
        with self._place.writing():
            self._place.partial.mkdir()

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write the cloud of a frame in contact."""
        if not result.contact:
            return
        comment = f"millimetres, sensor frame, t_ns {result.t_ns}"
        with self._place.writing():
            path = self._place.partial / f"{recorded.frame.seq:06d}.ply"
            path.write_bytes(ply(result.cloud.points_mm, comment, result.cloud.labels))

    def finish(self) -> None:
        """Complete the folder and move it to its final name."""
        self._place.take()

    def discard(self) -> None:
        """Remove the unfinished folder."""
        self._place.discard()
