"""Parse and encode the robot's poses, as lines and in binary, and track their numbers."""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from typing import Final

from tacshade_edge.errors import DecodeError
from tacshade_edge.robot.line import SEQ_MODULO, Line, crc16

T_NS_MAX: Final = 2**63 - 1
POSITION_MAX_MM: Final = 1e6
UNIT_TOLERANCE: Final = 1e-2  # robots often send only four decimals
# A pose up to this far behind is a repeat; an older number restarts the count.
POSES_BEHIND: Final = 64

_VALUES: Final = 8  # of a POSE line: the time, and `PoseValues`
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_TIME = re.compile(r"\d{1,19}")
_POSE = struct.Struct("<cHQ7f")
_CRC = struct.Struct("<H")
POSE_BYTES: Final = _POSE.size + _CRC.size

PoseValues = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One pose as the robot sent it: its number modulo 65536, if any,
    and its time on the robot's clock.

    `values` are ``base_T_flange``: x, y, z in mm, unit quaternion w, x, y, z.
    """

    seq: int | None
    t_ns: int
    values: PoseValues


def parse_time(text: str) -> int:
    """Parse a time in ns. Raises DecodeError."""
    if not _TIME.fullmatch(text) or int(text) > T_NS_MAX:
        raise DecodeError(
            f"found {text!r}, expected a whole number of nanoseconds from 0 to 2^63-1"
        )
    return int(text)


def parse_pose(line: Line) -> PoseSample:
    """Parse the arguments of ``POSE``. Raises DecodeError."""
    if len(line.args) != _VALUES:
        raise DecodeError(
            f"found {len(line.args)} values, expected the {_VALUES} values t x y z qw qx qy qz"
        )
    t_ns = parse_time(line.args[0])
    wrong = next((text for text in line.args[1:] if not _NUMBER.fullmatch(text)), None)
    if wrong is not None:
        raise DecodeError(f"found {wrong!r}, expected a number")
    return _checked(line.seq, t_ns, tuple(map(float, line.args[1:])))


def encode_pose(sample: PoseSample) -> bytes:
    """Encode a pose in binary: ``P``, number, time, seven floats, CRC."""
    raw = _POSE.pack(b"P", (sample.seq or 0) % SEQ_MODULO, sample.t_ns, *sample.values)
    return raw + _CRC.pack(crc16(raw))


def decode_pose(raw: bytes) -> PoseSample:
    """Decode a binary pose. Raises DecodeError."""
    if len(raw) != POSE_BYTES or raw[:1] != b"P":
        raise DecodeError(
            f"found {len(raw)} bytes, expected {POSE_BYTES} bytes that start with the letter P"
        )
    if _CRC.unpack_from(raw, _POSE.size)[0] != crc16(raw[: _POSE.size]):
        raise DecodeError("found a wrong checksum in a binary pose")
    _, seq, t_ns, *values = _POSE.unpack_from(raw)
    if t_ns > T_NS_MAX:
        raise DecodeError(f"found the time {t_ns}, expected at most 2^63-1 ns")
    return _checked(seq, t_ns, tuple(values))


def _checked(seq: int | None, t_ns: int, values: tuple[float, ...]) -> PoseSample:
    x, y, z, w, i, j, k = values
    # A kilometre: whoever sends more uses another unit.
    if not max(abs(x), abs(y), abs(z)) <= POSITION_MAX_MM:  # also rejects NaN
        raise DecodeError(
            f"found {x:g} {y:g} {z:g}, expected a position within {POSITION_MAX_MM:g} mm of the "
            "origin"
        )
    norm = math.sqrt(w * w + i * i + j * j + k * k)
    if not abs(norm - 1) <= UNIT_TOLERANCE:
        raise DecodeError(f"found a quaternion of length {norm:.4g}, expected length 1")
    return PoseSample(seq, t_ns, (x, y, z, w / norm, i / norm, j / norm, k / norm))


class PoseSequence:
    """Tracks pose numbers modulo 65536."""

    def __init__(self) -> None:
        self._newest: int | None = None

    def missing_before(self, seq: int | None) -> int | None:
        """The number of poses missing between this pose and the previous one;
        None for a repeated pose.

        A pose without a number (None) follows the previous one.
        """
        if seq is None:
            return 0
        missing = 0
        if self._newest is not None:
            ahead = (seq - self._newest) % SEQ_MODULO
            if -ahead % SEQ_MODULO < POSES_BEHIND:
                return None
            missing = ahead - 1 if ahead < SEQ_MODULO // 2 else 0
        self._newest = seq
        return missing
