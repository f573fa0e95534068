"""Exports of recordings as CSV and PLY; each file or folder appears whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import json
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import disk_errors, part, require_free, sync
from tacshade_edge.files.meshes import ply
from tacshade_edge.files.targets import check_folder, one_at_a_time, target_of
from tacshade_edge.reasons import ReasonCode, code_of
from tacshade_edge.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire.hand_topics import Finger, HandObjects, Motion
from tacshade_edge.wire.messages import encode_contact, touch_fields

Add = Callable[[RecordedFrame, Reconstruction], None]
"""Takes the next frame; an export is a context that gives one,
and completes the file when its block ends.
"""

_AXES: Final = "xyz"
_ALONG_AXES: Final = (
    "about_{}_mm",
    "translation_{}_mm",
    "rotation_{}_deg",
    "sigma_translation_{}_mm",
    "sigma_rotation_{}_deg",
)
_MOTION: Final = [
    "motion_since_ns",
    *[column.format(axis) for column in _ALONG_AXES for axis in _AXES],
    "unobservable",
    "left_out",
]


def check_new(path: Path) -> None:
    """Refuse the path of a new file or folder that `new_path` could not make now.

    Raises ConfigError if the name exists, and DeviceError if the disk is nearly full
    or cannot be written.
    """
    _refuse_taken(path)
    path = target_of(path)
    check_folder(path.parent)
    with disk_errors(path):
        # `exists` hides that a name is too long from Python 3.14 on.
        with contextlib.suppress(FileNotFoundError):
            part(path).lstat()
        require_free(path.parent)


def _refuse_taken(path: Path) -> None:
    if path.exists():
        raise ConfigError(
            f"{path}: already exists, expected a new name (--out)", code=ReasonCode.NAME_TAKEN
        )


@contextlib.contextmanager
def new_path(path: Path) -> Iterator[Path]:
    """The ``.part`` of a new file or folder, which gets its final name when the block ends;
    an error removes it.

    Raises ConfigError if the name exists, and DeviceError if the disk is nearly full
    or cannot be written.
    """
    check_new(path)
    path = target_of(path)
    partial = part(path)
    with disk_errors(path), contextlib.ExitStack() as stack:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Two would write the same incomplete file.
        stack.enter_context(one_at_a_time(path, "export", "writing"))
        # Again: another export may have finished it between the check and the lock.
        _refuse_taken(path)
        # What a write that was killed left behind.
        _remove(partial)
        try:
            yield partial
            # Before the rename: a power cut must not leave the final name on empty files.
            for written in (partial, *partial.rglob("*")):
                sync(written)
            partial.rename(path)
            sync(path.parent)
        finally:
            _remove(partial)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def contact_numbers(recorded: RecordedFrame, result: Reconstruction) -> dict[str, Any]:
    """The fields of ``contact`` (docs/reference/mqtt/frames.md) without ``fps``,
    which only a daemon knows.
    """
    # By the daemon's own encoder, so that both round alike.
    numbers: dict[str, Any] = json.loads(encode_contact(result, fps=0.0))
    del numbers["fps"]
    # A recording's results have none, so that equal recordings give equal bytes.
    numbers["wall_ns"] = recorded.wall_ns
    return numbers


@contextlib.contextmanager
def csv_export(path: Path, touch_names: Sequence[str]) -> Iterator[Add]:
    """A CSV file with a row per frame and empty cells for missing values;
    `touch_names` are a touch's quantities.
    """
    with new_path(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        header: list[str] = []

        def add(recorded: RecordedFrame, result: Reconstruction) -> None:
            numbers = _frame_numbers(recorded, result, touch_names)
            if not header:
                header.extend(numbers)
                writer.writerow(header)
            writer.writerow(numbers.values())

        yield add


def _frame_numbers(
    recorded: RecordedFrame, result: Reconstruction, touch_names: Sequence[str]
) -> dict[str, Any]:
    """A table row: image, times, the numbers of contact and touch, ``base_T_flange``;
    None for a missing value.
    """
    touch, frame = touch_fields(result.touch), recorded.frame
    return {
        "image": recorded.name,
        "valid": int(result.valid),
        "saturated": int(result.saturated),
        **contact_numbers(recorded, result),
        **{f"{key}_{name}": (touch[key] or {}).get(name) for key in touch for name in touch_names},
        "touch_reason_code": code_of(None if result.touch is None else result.touch.reason),
        **{
            f"flange_{name}": None if frame.pose is None else float(getattr(frame.pose, name))
            for name in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
        },
        "pose_error_us": None if frame.pose is None else frame.pose_error_us,
    }


@contextlib.contextmanager
def ply_export(folder: Path) -> Iterator[Add]:
    """A folder of ``SEQ.ply`` files: points of the skin in contact in mm, sensor frame,
    with their object's number.
    """
    with new_path(folder) as partial:
        partial.mkdir()

        def add(recorded: RecordedFrame, result: Reconstruction) -> None:
            if result.contact:
                comment = f"millimetres, sensor frame, t_ns {result.t_ns}"
                data = ply(result.cloud.points_mm, comment, result.cloud.labels)
                (partial / f"{recorded.frame.seq:06d}.ply").write_bytes(data)

        yield add


def write_hand_csv(path: Path, fingers: Sequence[str], messages: Iterable[HandObjects]) -> int:
    """Write a row per message of a hand; return the number of rows. Raises like `new_path`."""
    rows = 0
    with new_path(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        # Any finger has all columns.
        of_fingers = (f"{name}_{key}" for name in fingers for key in _finger(Finger(state="away")))
        writer.writerow(("t_ns", "wall_ns", "seq", *_MOTION, *of_fingers))
        for rows, message in enumerate(messages, 1):  # noqa: B007
            motion = [None] * len(_MOTION) if message.motion is None else _motion(message.motion)
            values = (
                value for name in fingers for value in _finger(message.fingers[name]).values()
            )
            writer.writerow((message.t_ns, message.wall_ns, message.seq, *motion, *values))
    return rows


def _motion(motion: Motion) -> list[Any]:
    # The diagonal of 6x6 values, whose rounding may leave one just below 0.
    sigmas = [round(math.sqrt(max(0.0, motion.covariance[7 * k])), 4) for k in range(6)]
    return [
        motion.since_ns,
        *motion.about_mm,
        *motion.translation_mm,
        *motion.rotation_deg,
        *sigmas,
        len(motion.unobservable),
        " ".join(motion.left_out),
    ]


def _finger(finger: Finger) -> dict[str, Any]:
    greatest = finger.objects[0] if finger.objects else None
    return {
        "state": finger.state,
        "seq": finger.seq,
        "depth_max_mm": None if greatest is None else greatest.depth_max_mm,
        "slip": None if greatest is None else greatest.slip,
        "touched": None if finger.state == "away" else int(finger.touched),
    }
