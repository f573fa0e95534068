"""The files of a run of `replay`, and the comparison of two runs; docs/how-to/replay.md describes
the format. ``summary.json`` marks a complete run, because it is renamed last; only ``timings.json``
depends on the clock.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.files.atomic_files import disk_errors, part, sync, write_whole
from tacshade_edge.reasons import reason_fields
from tacshade_edge.recording.recording import RecordedFrame
from tacshade_edge.regular_files import open_regular, read_regular
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire import binary
from tacshade_edge.wire.messages import touch_fields

HEIGHTS, CLOUDS, SHEARS, SUMMARY, TIMINGS = (
    "heights.bin",
    "clouds.bin",
    "shears.bin",
    "summary.json",
    "timings.json",
)
_ENCODERS = {
    HEIGHTS: binary.encode_height,
    CLOUDS: binary.encode_cloud,
    SHEARS: binary.encode_shear,
}
# The header's byte from which it states the payload's length (wire/wire_format.py).
_PAYLOAD_BYTES_AT = 84
_BETWEEN, _AROUND = ",\n", "[\n\n]\n"
SUMMARY_BYTES_MAX = 1 << 28
"""Most bytes of a summary that are read, and so written: a quarter of a million frames and more."""
_OF_OBJECT = (
    "label",
    "centroid_mm",
    "extent_mm",
    "depth_max_mm",
    "area_mm2",
    "normal",
    "shear_mm",
    "twist_deg",
    "id",
    "slip",
    "slip_mm_s",
    "name",
    "probability",
)
# The others have four digits: 0.1 µm.
_DIGITS = {"twist_deg": 3, "slip_mm_s": 3, "probability": 3}


class RunWriter:
    """Writes one run; a folder has a whole run or none, and an earlier one is removed at once.

    Raises DeviceError.
    """

    def __init__(self, folder: Path, *, calibration_crc32: int) -> None:
        self._folder = folder
        self._crc32 = calibration_crc32
        self._lines: list[str] = []
        self._bytes = 0
        self._streams: dict[str, BinaryIO] = {}
        self._whole = False
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            # The summary first: without it there is no run, whatever else a crash leaves.
            for name in (SUMMARY, TIMINGS, *_ENCODERS):
                (folder / name).unlink(missing_ok=True)
            try:
                for name in _ENCODERS:
                    self._streams[name] = part(folder / name).open("wb")
            except OSError:
                self.discard()
                raise

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write a frame."""
        frame = recorded.frame
        with disk_errors(self._folder):
            for name, encode in _ENCODERS.items():
                # `paper` computes none, and its file stays empty.
                if name == SHEARS and result.shear_mm is None:
                    continue
                payload = encode(
                    result,
                    calibration_crc32=self._crc32,
                    pose=frame.pose,
                    pose_error_us=frame.pose_error_us,
                )
                self._streams[name].write(payload)
        pose = frame.pose and [
            getattr(frame.pose, key) for key in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
        ]
        about = {"image": recorded.name, "seq": result.seq, "t_ns": result.t_ns}
        # As its line: a dict of each frame would take five times the memory.
        line = json.dumps({**about, **summary(result), "pose": pose})
        self._bytes += len(line) + len(_BETWEEN)
        if self._bytes - len(_BETWEEN) + len(_AROUND) > SUMMARY_BYTES_MAX:
            raise DeviceError(
                f"{self._folder / SUMMARY}: found more than {SUMMARY_BYTES_MAX >> 20} MiB after "
                f"{len(self._lines)} frames, expected what --against can read; replay fewer frames"
            )
        self._lines.append(line)

    def finish(self, timings: Mapping[str, Any]) -> None:
        """Complete the run."""
        with disk_errors(self._folder):
            for stream in self._streams.values():
                stream.flush()
                os.fsync(stream.fileno())
                stream.close()
            # One line per record, for diff and grep.
            lines = _BETWEEN.join(self._lines)
            for name in _ENCODERS:
                part(self._folder / name).replace(self._folder / name)
            # The summary last: with it, the run is whole.
            write_whole(self._folder / TIMINGS, (json.dumps(timings, indent=2) + "\n").encode())
            write_whole(self._folder / SUMMARY, f"[\n{lines}\n]\n".encode())
            sync(self._folder)
        self._whole = True

    def discard(self) -> None:
        """Remove an unfinished run; after `finish` only close the files."""
        # What fails here must not hide the error that ended the run.
        for stream in self._streams.values():
            with contextlib.suppress(OSError):
                stream.close()
        for name in () if self._whole else (SUMMARY, *_ENCODERS, TIMINGS):
            for path in (part(self._folder / name), self._folder / name):
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)


def read_summary(folder: Path) -> list[dict[str, Any]]:
    """The records of a run.

    Raises ConfigError without a complete run, and DecodeError if the summary is damaged.
    """
    path = folder / SUMMARY
    try:
        records = json.loads(read_regular(path, SUMMARY_BYTES_MAX))
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror or error}, expected a run written by `replay --out`"
        ) from None
    except (ValueError, RecursionError) as error:
        raise DecodeError(
            f"{path}: the file is not valid JSON: {error}; expected a run written by `replay --out`"
        ) from None
    if not (isinstance(records, list) and all(isinstance(r, dict) and "seq" in r for r in records)):
        raise DecodeError(
            f"{path}: found JSON of another form, expected the summary of a run written by "
            "`replay --out`"
        )
    return records


def payloads(folder: Path, name: str) -> Iterator[bytes]:
    """Every payload of ``heights.bin``, ``clouds.bin`` or ``shears.bin``, in order.

    Raises ConfigError if the file is missing, and DecodeError if it is truncated
    or states an impossible length.
    """
    path = folder / name
    try:
        with open_regular(path, sys.maxsize) as stream:
            while head := stream.read(binary.HEADER_BYTES):
                size = int.from_bytes(head[_PAYLOAD_BYTES_AT : _PAYLOAD_BYTES_AT + 4], "little")
                # Before it is read: a flipped bit may ask for 4 GB.
                if size > binary.PAYLOAD_BYTES_MAX:
                    at = f"{path}, byte {stream.tell() - len(head) + _PAYLOAD_BYTES_AT}"
                    raise DecodeError(
                        f"{at}: found {size} payload bytes, expected at most "
                        f"{binary.PAYLOAD_BYTES_MAX}"
                    )
                body = stream.read(size)
                if len(head) < binary.HEADER_BYTES or len(body) < size:
                    raise DecodeError(
                        f"{path}: cut short after {stream.tell()} bytes, expected a whole run"
                    )
                yield head + body
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror or error}, expected a run written by `replay --out`"
        ) from None


def summary(result: Reconstruction) -> dict[str, Any]:
    """A reconstruction's values except the arrays, with lengths rounded to 0.1 µm; None where the
    frame does not say.
    """
    known = result.valid and not result.touched
    return {
        "profile": result.profile,
        "valid": result.valid,
        **reason_fields(result.reason),
        "contact": result.contact if result.valid else None,
        "touched": result.touched if result.valid else None,
        "saturated": result.saturated,
        **reason_fields(result.degraded, "degraded"),
        "depth_max_mm": _rounded(result.depth_max_mm) if known else None,
        "volume_mm3": _rounded(result.volume_mm3) if known else None,
        "repaired_px": result.repaired_px,
        "shear_mm": _rounded(result.shear_of_contact_mm),
        **touch_fields(result.touch),
        **reason_fields(None if result.touch is None else result.touch.reason, "touch_reason"),
        "objects": [
            {name: _rounded(getattr(each, name), _DIGITS.get(name, 4)) for name in _OF_OBJECT}
            for each in result.objects
        ],
    }


def _rounded(value: Any, digits: int = 4) -> Any:
    if isinstance(value, tuple):
        return [round(each, digits) for each in value]
    return value if value is None or isinstance(value, str) else round(value, digits)


def first_difference(folder: Path, against: Path) -> str:
    """The frame, field and size of the first difference, as a line;
    empty if the runs are the same bytes.

    Raises ConfigError if a folder has no complete run, and DecodeError if a run is damaged.
    """
    runs = folder, against
    records, others = (read_summary(run) for run in runs)
    names = [HEIGHTS, CLOUDS]
    if all((run / SHEARS).exists() and (run / SHEARS).stat().st_size for run in runs):
        names.append(SHEARS)
    streams = [(name, payloads(folder, name), payloads(against, name)) for name in names]
    # As far as both go; only if they are equal there is another length the difference.
    for index, (record, other) in enumerate(zip(records, others, strict=False)):
        found = _difference(record, other)
        for name, mine, theirs in streams:
            one, two = next(mine, None), next(theirs, None)
            for run, payload in zip(runs, (one, two), strict=True):
                if payload is None:
                    raise DecodeError(
                        f"{run / name}: found {index} payloads, expected {len(read_summary(run))}"
                    )
            if not found and one is not None and two is not None and one != two:
                difference = _difference(_values(one), _values(two))
                found = f"{name}: {difference or 'the bytes differ where no field is'}"
        if found:
            return f"frame {index} ({record.get('image')}): {found}"
    return "" if len(records) == len(others) else f"frames: {len(records)}, against {len(others)}"


def _values(payload: bytes) -> dict[str, Any]:
    message = binary.decode(payload)
    return {field.name: getattr(message, field.name) for field in fields(message)}


def _difference(one: Any, two: Any) -> str:
    """The first place where two values, lists or dicts of them differ, and how;
    empty if they do not.
    """
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        if one.shape != two.shape:
            return f"shape {one.shape}, against {two.shape}"
        # NaN, outside the disc, is equal to NaN here.
        count = np.count_nonzero(~((one == two) | (np.isnan(one) & np.isnan(two))))
        return f"{count} of {one.size} values differ" if count else ""
    if isinstance(one, list) and isinstance(two, list):
        one, two = dict(enumerate(one)), dict(enumerate(two))
    if isinstance(one, dict) and isinstance(two, dict):
        found = ((key, _difference(one.get(key), two.get(key))) for key in one | two)
        return next((f"{key}: {how}" for key, how in found if how), "")
    return "" if one == two else f"{one}, against {two}"


def _answer(record: dict[str, Any]) -> tuple[Any, bool]:
    """Contact, no contact, or touched; an older run has no frame of the last kind."""
    return record.get("contact"), bool(record.get("touched"))


def figures(folder: Path, against: Path) -> list[str]:
    """Differences in contact and depth over the common frames, a line each.

    Raises like `first_difference`.
    """
    pairs = list(zip(read_summary(folder), read_summary(against), strict=False))
    if not pairs:
        return []
    places = [f"frame {k} ({one.get('image')})" for k, (one, _) in enumerate(pairs)]
    changed = [
        place
        for place, (one, two) in zip(places, pairs, strict=True)
        if _answer(one) != _answer(two)
    ]
    first = f", first {changed[0]}" if changed else ""
    # None: the depth is unknown.
    depths_mm = np.array(
        [[one.get("depth_max_mm") or 0.0, two.get("depth_max_mm") or 0.0] for one, two in pairs],
        float,
    )
    apart_mm = np.abs(depths_mm[:, 0] - depths_mm[:, 1])
    worst = int(np.argmax(apart_mm))
    return [
        f"contact: differs in {len(changed)} of {len(pairs)} frames{first}",
        (
            f"depth_max_mm: mean {apart_mm.mean():.4f}, worst {apart_mm[worst]:.4f} mm apart in "
            f"{places[worst]}"
        ),
    ]
