"""Detect the robot's mode from its bytes, so that neither side waits forever when only one has changed its mode."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, Literal

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.pose import POSE_BYTES, decode_pose

Mode = Literal["ASCII", "BIN"]

POSE_FRAME_BYTES: Final = POSE_BYTES + 1  # COBS of a pose, without its zero
# Among frames, but not inside one, where an L precedes the line.
_HELLO = re.compile(rb"((?:(?<!L)#\d{1,5} +|(?<![L ]))HELLO 1[ -~]*)[\r\n]")


def find_hello(raw: bytes) -> re.Match[bytes] | None:
    """Find an ASCII ``HELLO`` among frames (group 1), sent by a robot that restarted; by chance 2^-56 per byte."""
    return _HELLO.search(raw) if b"HELLO 1" in raw else None


def first_pose_frame(frames: Sequence[bytes]) -> int | None:
    """Index of the first whole binary pose, sent by a robot that continues in BIN after the daemon restarted."""
    return next((at for at, frame in enumerate(frames) if len(frame) == POSE_FRAME_BYTES and _is_pose(frame)), None)


def _is_pose(frame: bytes) -> bool:
    try:
        decode_pose(cobs.decode(frame))
    except DecodeError:
        return False
    return True
