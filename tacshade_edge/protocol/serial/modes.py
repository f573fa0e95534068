"""Which of the two modes the robot speaks, seen from the bytes: neither side waits for ever when only one changed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, Literal

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.pose import POSE_BYTES, decode_pose

Mode = Literal["ASCII", "BIN"]

POSE_FRAME_BYTES: Final = POSE_BYTES + 1  # COBS of a pose, without its zero
# Among frames, but not in one: there an L comes before the line.
_HELLO = re.compile(rb"((?:(?<!L)#\d{1,5} +|(?<![L ]))HELLO 1[ -~]*)[\r\n]")


def find_hello(raw: bytes) -> re.Match[bytes] | None:
    """Find a ``HELLO`` in ASCII among frames (group 1): a robot that began anew. By chance: 2^-56 a byte."""
    return _HELLO.search(raw) if b"HELLO 1" in raw else None


def first_pose_frame(frames: Sequence[bytes]) -> int | None:
    """Index of the first whole binary pose: what robots send that go on in BIN after the daemon was restarted."""
    return next((at for at, frame in enumerate(frames) if len(frame) == POSE_FRAME_BYTES and _is_pose(frame)), None)


def _is_pose(frame: bytes) -> bool:
    try:
        decode_pose(cobs.decode(frame))
    except DecodeError:
        return False
    return True
