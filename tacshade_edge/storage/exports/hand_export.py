"""Exports a hand's messages as CSV and as MCAP."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from tacshade_edge.protocol.hand import encode_hand
from tacshade_edge.protocol.topics import Finger, HandObjects, Motion
from tacshade_edge.storage.exports.files import new_file
from tacshade_edge.version import installed_version

_AXES: Final = ("x", "y", "z")
_MOTION: Final = (
    *("motion_since_ns", *(f"about_{axis}_mm" for axis in _AXES)),
    *(f"translation_{axis}_mm" for axis in _AXES),
    *(f"rotation_{axis}_deg" for axis in _AXES),
    *(f"sigma_translation_{axis}_mm" for axis in _AXES),
    *(f"sigma_rotation_{axis}_deg" for axis in _AXES),
    *("unobservable", "left_out"),
)


def write_csv(path: Path, fingers: Sequence[str], messages: Iterable[HandObjects]) -> int:
    """Write a row per message, empty cells for missing values; return the number of rows. Raises like `NewPlace`."""
    rows = 0
    with new_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        of_fingers = (f"{name}_{key}" for name in fingers for key in _finger(Finger(state="away")))
        writer.writerow(("t_ns", "wall_ns", "seq", *_MOTION, *of_fingers))
        for rows, message in enumerate(messages, 1):  # noqa: B007
            motion = [""] * len(_MOTION) if message.motion is None else _motion(message.motion)
            values = (value for name in fingers for value in _finger(message.fingers[name]).values())
            writer.writerow((message.t_ns, message.wall_ns, message.seq, *motion, *values))
    return rows


def write_mcap(path: Path, hand_id: str, messages: Iterable[HandObjects]) -> int:
    """Write the topic ``/tacshade/hand/ID/objects``; return the number of messages. Raises like `NewPlace`."""
    from tacshade_edge.storage.recording.mcap.writer import McapWriter  # needs the extra

    count = 0
    with new_file(path) as partial, partial.open("wb") as stream:
        writer = McapWriter(stream, f"hand/{hand_id}")
        writer.describe("tacshade", {"version": installed_version(), "hand_id": hand_id})
        for count, message in enumerate(messages, 1):  # noqa: B007
            writer.write("objects", encode_hand(message), message.wall_ns, message.seq)
        writer.finish()
    return count


def _motion(motion: Motion) -> list[Any]:
    sigmas = [round(math.sqrt(max(0.0, motion.covariance[7 * k])), 4) for k in range(6)]
    return [
        *(motion.since_ns, *motion.about_mm, *motion.translation_mm, *motion.rotation_deg),
        *(*sigmas, len(motion.unobservable), " ".join(motion.left_out)),
    ]


def _finger(finger: Finger) -> dict[str, Any]:
    greatest = finger.objects[0] if finger.objects else None
    return {
        "state": finger.state,
        "seq": finger.seq,
        "margin": finger.margin,
        "depth_max_mm": None if greatest is None else greatest.depth_max_mm,
        "slip": None if greatest is None else greatest.slip,
    }
