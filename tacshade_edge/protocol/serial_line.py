"""One line and one binary pose of the robot's serial channel: bytes to values and back.

A line is ``[#seq] VERB args[*CCCC]`` in printable ASCII, at most 256 bytes with its LF; CCCC is CRC-16/XMODEM of
all before the ``*``. docs/serial.md has the whole grammar.
"""

from __future__ import annotations

import binascii
import math
import re
import struct
from dataclasses import dataclass
from typing import Final, Literal

from tacshade_edge.errors import DecodeError

LINE_BYTES_MAX: Final = 256
SEQ_MODULO: Final = 1 << 16
T_NS_MAX: Final = 2**63 - 1
POSITION_MAX_MM: Final = 1e6
UNIT_TOLERANCE: Final = 1e-2  # four decimals and no more are common

_HEAD = re.compile(r"(?:#(\S*) +)?(\S+) *(.*)")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_TIME = re.compile(r"\d{1,19}")
_POSE = struct.Struct("<cHQ7f")
_CRC = struct.Struct("<H")
POSE_BYTES: Final = _POSE.size + _CRC.size

PoseValues = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Line:
    """A line that was understood.

    Attributes
    ----------
    seq : int or None
        0 to 65535.
    verb : str
        In capitals.
    args : tuple of str
    text : str
        All before the ``*``: two lines with the same number and text are one line, sent twice.
    checked : bool
        It had a checksum, and the right one.
    """

    seq: int | None
    verb: str
    args: tuple[str, ...]
    text: str
    checked: bool


@dataclass(frozen=True, slots=True)
class BadLine:
    """A line that was not: ``GARBAGE`` (not printable, too long), ``CRC`` (damaged) or ``SYNTAX``, and why."""

    code: Literal["GARBAGE", "CRC", "SYNTAX"]
    why: str


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One pose as the robot sent it.

    Attributes
    ----------
    seq : int or None
        The stream's own number, modulo 65536.
    t_ns : int
        The robot's clock.
    values : 7 floats
        ``base_T_flange``: x, y, z in mm, unit quaternion w, x, y, z.
    """

    seq: int | None
    t_ns: int
    values: PoseValues


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM: polynomial 0x1021, from 0, not reflected."""
    return binascii.crc_hqx(data, 0)


def seal(text: str) -> bytes:
    """The bytes of a line: its checksum and LF added."""
    raw = text.encode("ascii")
    return b"%s*%04X\n" % (raw, crc16(raw))


def parse_line(raw: bytes) -> Line | BadLine:
    """Understand a line without its end."""
    if len(raw) >= LINE_BYTES_MAX or not all(32 <= byte < 127 for byte in raw):
        return BadLine("GARBAGE", f"expected at most {LINE_BYTES_MAX - 1} printable ASCII characters")
    text, star, digits = raw.decode("ascii").rpartition("*")
    if not star:
        text = digits
    elif not re.fullmatch("[0-9A-Fa-f]{4}", digits):
        return BadLine("CRC", f"found {digits[:16]!r} after the star, expected four hex digits")
    elif int(digits, 16) != (crc := crc16(raw[: len(text)])):
        return BadLine("CRC", f"found {digits.upper()}, expected {crc:04X}")
    head = _HEAD.fullmatch(text.strip(" "))
    if head is None or (head[1] is None and head[2].startswith("#")):
        return BadLine("SYNTAX", "expected [#seq] VERB args, and a star with the CRC where wanted")
    seq = head[1]
    if seq is not None and not (re.fullmatch(r"\d{1,5}", seq) and int(seq) < SEQ_MODULO):
        return BadLine("SYNTAX", f"found #{seq[:16]}, expected # and 0 to {SEQ_MODULO - 1}")
    return Line(None if seq is None else int(seq), head[2].upper(), tuple(head[3].split()), text, bool(star))


def parse_time(text: str) -> int:
    """A time in ns. Raises DecodeError."""
    if not _TIME.fullmatch(text) or int(text) > T_NS_MAX:
        raise DecodeError(f"found {text!r}, expected whole nanoseconds from 0 to 2^63-1")
    return int(text)


def parse_pose(line: Line) -> PoseSample:
    """Understand the arguments of ``POSE``. Raises DecodeError."""
    if len(line.args) != 8:
        raise DecodeError(f"found {len(line.args)} values, expected t x y z qw qx qy qz")
    t_ns = parse_time(line.args[0])
    wrong = next((text for text in line.args[1:] if not _NUMBER.fullmatch(text)), None)
    if wrong is not None:
        raise DecodeError(f"found {wrong!r}, expected a number")
    return _checked(line.seq, t_ns, tuple(map(float, line.args[1:])))


def encode_pose(sample: PoseSample) -> bytes:
    """The binary form: ``P``, number, time, seven floats, CRC."""
    raw = _POSE.pack(b"P", (sample.seq or 0) % SEQ_MODULO, sample.t_ns, *sample.values)
    return raw + _CRC.pack(crc16(raw))


def decode_pose(raw: bytes) -> PoseSample:
    """Understand the binary form. Raises DecodeError."""
    if len(raw) != POSE_BYTES or raw[:1] != b"P":
        raise DecodeError(f"found {len(raw)} bytes, expected P and {POSE_BYTES - 1} more")
    if _CRC.unpack_from(raw, _POSE.size)[0] != crc16(raw[: _POSE.size]):
        raise DecodeError("the checksum of a binary pose is wrong")
    _, seq, t_ns, *values = _POSE.unpack_from(raw)
    if t_ns > T_NS_MAX:
        raise DecodeError(f"found the time {t_ns}, expected at most 2^63-1 ns")
    return _checked(seq, t_ns, tuple(values))


def _checked(seq: int | None, t_ns: int, values: tuple[float, ...]) -> PoseSample:
    x, y, z, w, i, j, k = values
    if not max(abs(x), abs(y), abs(z)) <= POSITION_MAX_MM:  # NaN too
        raise DecodeError(f"found {x:g} {y:g} {z:g}, expected a position within {POSITION_MAX_MM:g} mm")
    norm = math.sqrt(w * w + i * i + j * j + k * k)
    if not abs(norm - 1) <= UNIT_TOLERANCE:
        raise DecodeError(f"found the norm {norm:.4g}, expected a unit quaternion")
    return PoseSample(seq, t_ns, (x, y, z, w / norm, i / norm, j / norm, k / norm))
