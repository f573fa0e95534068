"""The files of a run, written frame by frame; docs/how-to/replay.md describes the format.

``heights.bin`` and ``clouds.bin`` hold the wire payloads one after another (each header holds its length);
``summary.json`` has a record for each frame and marks a complete run, because it is renamed last; only
``timings.json`` depends on the clock.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.protocol import wire
from tacshade_edge.protocol.messages import touch_fields
from tacshade_edge.reasons import reason_fields
from tacshade_edge.regular_files import open_regular, read_regular
from tacshade_edge.storage.atomic_files import disk_errors, part, sync, write_whole
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction

HEIGHTS, CLOUDS, SHEARS, SUMMARY, TIMINGS = "heights.bin", "clouds.bin", "shears.bin", "summary.json", "timings.json"
_ENCODERS = {HEIGHTS: wire.encode_height, CLOUDS: wire.encode_cloud, SHEARS: wire.encode_shear}
_PAYLOAD_BYTES_AT = 84
_SUMMARY_BYTES_MAX = 1 << 28


class RunWriter:
    """Writes one run; a folder has a complete run or none, and an earlier run in it is removed at once.

    The methods raise DeviceError if the folder cannot be written.
    """

    def __init__(self, folder: Path, *, calibration_crc32: int) -> None:
        self._folder = folder
        self._crc32 = calibration_crc32
        self._records: list[dict[str, Any]] = []
        self._streams: dict[str, BinaryIO] = {}
        self._whole = False
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name in (SUMMARY, TIMINGS, *_ENCODERS):
                (folder / name).unlink(missing_ok=True)
            for name in _ENCODERS:
                self._streams[name] = part(folder / name).open("wb")

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write a frame."""
        frame = recorded.frame
        with disk_errors(self._folder):
            for name, encode in _ENCODERS.items():
                if name == SHEARS and result.shear_mm is None:
                    continue
                payload = encode(
                    result, calibration_crc32=self._crc32, pose=frame.pose, pose_error_us=frame.pose_error_us
                )
                self._streams[name].write(payload)
        self._records.append(_record(recorded, result))

    def finish(self, timings: Mapping[str, Any]) -> None:
        """Complete the run."""
        with disk_errors(self._folder):
            for stream in self._streams.values():
                stream.flush()
                os.fsync(stream.fileno())
                stream.close()
            lines = ",\n".join(json.dumps(record) for record in self._records)  # one line per record, for diff and grep
            for name in _ENCODERS:
                part(self._folder / name).replace(self._folder / name)
            write_whole(self._folder / TIMINGS, (json.dumps(timings, indent=2) + "\n").encode())
            write_whole(self._folder / SUMMARY, f"[\n{lines}\n]\n".encode())
            sync(self._folder)
        self._whole = True

    def discard(self) -> None:
        """Remove an unfinished run; after `finish` only close the files."""
        for stream in self._streams.values():
            with contextlib.suppress(OSError):
                stream.close()
        for name in () if self._whole else (*_ENCODERS, TIMINGS):
            for path in (part(self._folder / name), self._folder / name):
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)


def _record(recorded: RecordedFrame, result: Reconstruction) -> dict[str, Any]:
    pose = recorded.frame.pose
    return {
        "image": recorded.name,
        "seq": result.seq,
        "t_ns": result.t_ns,
        **summary(result),
        "pose": None if pose is None else [pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz],
    }


def read_summary(folder: Path) -> list[dict[str, Any]]:
    """The records of a run. Raises ConfigError without a complete run, and DecodeError if the summary is damaged."""
    path = folder / SUMMARY
    try:
        records = json.loads(read_regular(path, _SUMMARY_BYTES_MAX))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}, expected a run written by `replay --out`") from None
    except (ValueError, RecursionError) as error:
        raise DecodeError(
            f"{path}: the file is not valid JSON: {error}; expected a run written by `replay --out`"
        ) from None
    if not (isinstance(records, list) and all(isinstance(r, dict) and "seq" in r for r in records)):
        raise DecodeError(
            f"{path}: found JSON of another form, expected the summary of a run written by `replay --out`"
        )
    return records


def payloads(folder: Path, name: str) -> Iterator[bytes]:
    """Every payload of ``heights.bin``, ``clouds.bin`` or ``shears.bin``, in order.

    Raises ConfigError if the file is missing, and DecodeError if it is truncated or states an impossible length.
    """
    path = folder / name
    try:
        with open_regular(path, sys.maxsize) as stream:
            while head := stream.read(wire.HEADER_BYTES):
                size = int.from_bytes(head[_PAYLOAD_BYTES_AT : _PAYLOAD_BYTES_AT + 4], "little")
                if size > wire.PAYLOAD_BYTES_MAX:
                    at = f"{path}, byte {stream.tell() - len(head) + _PAYLOAD_BYTES_AT}"
                    raise DecodeError(f"{at}: found {size} payload bytes, expected at most {wire.PAYLOAD_BYTES_MAX}")
                body = stream.read(size)
                if len(head) < wire.HEADER_BYTES or len(body) < size:
                    raise DecodeError(f"{path}: cut short after {stream.tell()} bytes, expected a whole run")
                yield head + body
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}, expected a run written by `replay --out`") from None


def summary(result: Reconstruction) -> dict[str, Any]:
    """A reconstruction's values except the arrays, with lengths rounded to 0.1 µm."""
    return {
        "profile": result.profile,
        "valid": result.valid,
        **reason_fields(result.reason),
        "contact": result.contact,
        "saturated": result.saturated,
        **reason_fields(result.degraded, "degraded"),
        "depth_max_mm": round(result.depth_max_mm, 4),
        "volume_mm3": round(result.volume_mm3, 4),
        "repaired_px": result.repaired_px,
        "shear_mm": _rounded(result.shear_of_contact_mm),
        **touch_fields(result.touch),
        **reason_fields(None if result.touch is None else result.touch.reason, "touch_reason"),
        "objects": [
            {
                "label": o.label,
                "centroid_mm": [round(v, 4) for v in o.centroid_mm],
                "extent_mm": [round(v, 4) for v in o.extent_mm],
                "depth_max_mm": round(o.depth_max_mm, 4),
                "area_mm2": round(o.area_mm2, 4),
                "normal": _rounded(o.normal),
                "shear_mm": _rounded(o.shear_mm),
                "twist_deg": None if o.twist_deg is None else round(o.twist_deg, 3),
                "id": o.id,
                "slip": o.slip,
                "slip_mm_s": None if o.slip_mm_s is None else round(o.slip_mm_s, 3),
            }
            for o in result.objects
        ],
    }


def _rounded(values: Sequence[float] | None) -> list[float] | None:
    return None if values is None else [round(v, 4) for v in values]
