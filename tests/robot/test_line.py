"""Lines and binary poses against the literal vectors, which docs/reference/serial.md quotes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import (
    FRAME_BYTES_MAX,
    Framing,
    LinkCounts,
    Mode,
    Unit,
    cobs_decode,
    cobs_encode,
)
from tacshade_edge.robot.line import LINE_BYTES_MAX, Line, crc16, parse_line, seal
from tacshade_edge.robot.pose import PoseSample, decode_pose, encode_pose, parse_pose
from tacshade_edge.wire.error_words import ERROR_WORDS

VECTORS = json.loads((Path(__file__).parents[1] / "wire" / "vectors" / "serial.json").read_text())
QUATERNIONS = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-3)


@pytest.mark.parametrize("vector", VECTORS["crc"], ids=lambda v: v["text"] or "empty")
def test_checksum(vector: dict[str, str]) -> None:
    assert f"{crc16(vector['text'].encode()):04X}" == vector["crc"]
    assert seal(vector["text"]).decode() == f"{vector['text']}*{vector['crc']}\n"


@pytest.mark.parametrize("vector", VECTORS["lines"], ids=lambda v: v["raw"])
def test_line(vector: dict[str, Any]) -> None:
    line = parse_line(vector["raw"].encode())
    assert isinstance(line, Line)
    found = {"seq": line.seq, "verb": line.verb, "args": [*line.args], "checked": line.checked}
    assert found == {key: vector[key] for key in found}


@pytest.mark.parametrize("vector", VECTORS["bad_lines"], ids=lambda v: v["raw"])
def test_bad_line(vector: dict[str, str]) -> None:
    line = parse_line(vector["raw"].encode())
    assert isinstance(line, Reason)
    assert ERROR_WORDS.get(line.code, "GARBAGE") == vector["code"]


def test_a_line_has_at_most_256_bytes_with_its_end() -> None:
    longest = "HELP " + "x" * (LINE_BYTES_MAX - 1 - 5 - 5)
    assert len(seal(longest)) == LINE_BYTES_MAX
    assert isinstance(parse_line(seal(longest)[:-1]), Line)
    too_long = Reason(
        ReasonCode.NOT_A_LINE,
        "found an unprintable or overlong line, expected at most 255 printable ASCII characters",
    )
    assert parse_line(seal(longest + "x")[:-1]) == too_long


@given(st.integers(0, 2**32 - 1), st.integers(1, 63))
def test_two_wrong_bits_of_a_line_are_noticed(first: int, distance: int) -> None:
    raw = bytearray(seal("#17 STITCH BEGIN pad-1 of the long name that makes the line longer")[:-1])
    for bit in (first, first + distance):
        place = bit % (8 * (len(raw) - 5))
        raw[place // 8] ^= 1 << place % 8
    assert isinstance(parse_line(bytes(raw)), Reason)


@pytest.mark.parametrize("vector", VECTORS["poses"], ids=lambda v: str(v["seq"]))
def test_binary_pose(vector: dict[str, Any]) -> None:
    pose = tuple(vector["values"])
    sample = PoseSample(vector["seq"], vector["t_ns"], pose)  # type: ignore[arg-type]
    assert encode_pose(sample).hex() == vector["hex"]
    assert (cobs_encode(encode_pose(sample)) + b"\0").hex() == vector["frame"]
    assert decode_pose(bytes.fromhex(vector["hex"])) == sample


@given(
    st.integers(0, 65535),
    st.integers(0, 2**63 - 1),
    st.tuples(*[st.floats(-1e5, 1e5, width=32)] * 3),
    QUATERNIONS,
)
def test_poses_come_back(seq: int, t_ns: int, xyz: tuple[float, ...], q: tuple[float, ...]) -> None:
    unit = tuple(v / math.hypot(*q) for v in q)
    sample = PoseSample(seq, t_ns, (*xyz, *unit))  # type: ignore[arg-type]
    binary = decode_pose(encode_pose(sample))
    line = parse_line(seal(f"#{seq} POSE {t_ns} " + " ".join(map(repr, sample.values)))[:-1])
    assert isinstance(line, Line)
    for back in (binary, parse_pose(line)):
        assert (back.seq, back.t_ns, back.values[:3]) == (seq, t_ns, pytest.approx(xyz, rel=1e-6))
        assert back.values[3:] == pytest.approx(unit, abs=1e-6)
        assert math.hypot(*back.values[3:]) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("args", "why"),
    [
        ("1 2 3 4 1 0 0", "found 7 values"),
        ("1.5 0 0 0 1 0 0 0", "'1.5', expected a whole number of nanoseconds"),
        ("-1 0 0 0 1 0 0 0", "'-1', expected a whole number of nanoseconds"),
        ("9223372036854775808 0 0 0 1 0 0 0", "expected a whole number of nanoseconds"),
        ("1 nan 0 0 1 0 0 0", "'nan', expected a number"),
        ("1 0 1_0 0 1 0 0 0", "'1_0', expected a number"),
        ("1 0 1e9 0 1 0 0 0", "expected a position within"),
        ("1 0 1e999 0 1 0 0 0", "expected a position within"),
        ("1 0 0 0 1 1 0 0", "a quaternion of length 1.414, expected length 1"),
        ("1 0 0 0 0 0 0 0", "a quaternion of length 0, expected length 1"),
    ],
)
def test_a_pose_that_is_none(args: str, why: str) -> None:
    line = parse_line(f"POSE {args}".encode())
    assert isinstance(line, Line)
    with pytest.raises(DecodeError, match=why):
        parse_pose(line)


@pytest.mark.parametrize("value", [math.nan, math.inf, 2e6])
def test_a_binary_pose_that_is_none(value: float) -> None:
    raw = encode_pose(PoseSample(1, 2, (value, 0, 0, 1, 0, 0, 0)))
    with pytest.raises(DecodeError, match="expected a position within"):
        decode_pose(raw)


def test_a_damaged_binary_pose() -> None:
    raw = encode_pose(PoseSample(1, 2, (0, 0, 0, 1, 0, 0, 0)))
    for at in range(1, len(raw)):
        with pytest.raises(DecodeError, match="checksum"):
            decode_pose(raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :])
    with pytest.raises(DecodeError, match="found 40 bytes"):
        decode_pose(raw[:-1])


FULL = bytes(range(1, 255))
POSE = cobs_encode(encode_pose(PoseSample(1, 2, (0, 0, 0, 1, 0, 0, 0))))


@pytest.mark.parametrize(
    ("data", "encoded"),
    [  # the examples of the paper's readers: Wikipedia's table
        (b"\0", "0101"),
        (b"\x11\x22\0\x33", "0311220233"),
        (b"\x11\x22\x33\x44", "0511223344"),
        (FULL, "ff" + FULL.hex()),
        (b"\0" + FULL, "01ff" + FULL.hex()),
        (FULL + b"\xff", "ff" + FULL.hex() + "02ff"),
        (FULL + b"\0", "ff" + FULL.hex() + "0101"),
        (b"", "01"),
    ],
)
def test_known_frames(data: bytes, encoded: str) -> None:
    assert cobs_encode(data).hex() == encoded
    assert cobs_decode(bytes.fromhex(encoded)) == data


@given(
    st.binary(max_size=600)
    | st.lists(st.sampled_from([b"\0", FULL, b"\x05" * 253]), max_size=5).map(b"".join)
)
def test_every_frame_comes_back_and_has_no_zero(data: bytes) -> None:
    encoded = cobs_encode(data)
    assert b"\0" not in encoded
    assert len(encoded) <= len(data) + 1 + len(data) // 254
    assert cobs_decode(encoded) == data


@pytest.mark.parametrize("wrong", ["05112233", "0311002202", "ff01"])
def test_a_cut_frame_or_one_with_a_zero_is_refused(wrong: str) -> None:
    with pytest.raises(DecodeError, match="COBS"):
        cobs_decode(bytes.fromhex(wrong))


def units(framing: Framing, data: bytes, chunk: int) -> list[Unit]:
    found = []
    for at in range(0, len(data), chunk):
        framing.feed(data[at : at + chunk])
        while (unit := framing.next_unit()) is not None:
            found.append(unit)
    return found


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_lines_and_frames_however_they_are_cut(chunk: int) -> None:
    framing = Framing(LinkCounts())
    assert units(framing, b"STATUS\r\n\nHELP\r", chunk) == [
        Unit(b"STATUS", True),
        Unit(b"HELP", True),
    ]
    framing.switch("BIN")
    assert units(framing, b"\x02a\0\0\x02b\0\x02", chunk) == [
        Unit(b"\x02a", False),
        Unit(b"\x02b", False),
    ]
    assert units(framing, b"c\0", chunk) == [Unit(b"\x02c", False)], "what had begun was kept"


@pytest.mark.parametrize(
    ("mode", "end", "longest"), [("ASCII", b"\n", LINE_BYTES_MAX), ("BIN", b"\0", FRAME_BYTES_MAX)]
)
def test_what_never_ends_is_not_kept_and_counted(mode: Mode, end: bytes, longest: int) -> None:
    counts = LinkCounts()
    framing = Framing(counts)
    framing.switch(mode)
    assert units(framing, b"x" * 10_000, 97) == []
    assert 10_000 - counts.garbage_bytes <= longest + 97, "more is kept"
    assert units(framing, end + b"y" + end, 97) == [Unit(b"y", mode == "ASCII")]
    assert (counts.garbage, counts.garbage_bytes) == (1, 10_000)


def test_a_whole_pose_proves_binary_mode_and_a_hello_ends_it() -> None:
    framing = Framing(LinkCounts())
    assert units(framing, b"\x07junk\0" + POSE + b"\0", 5) == [Unit(POSE, False)]
    assert framing.mode == "BIN"
    assert units(framing, POSE[:9] + b"\n#1 HELLO 1\nSTATUS\n", 1000) == [
        Unit(b"#1 HELLO 1", True),
        Unit(b"STATUS", True),
    ]
    assert framing.mode == "ASCII"
