from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial.framing import (
    FRAME_BYTES_MAX,
    Framing,
    LinkCounts,
    Mode,
    Unit,
    cobs_decode,
    cobs_encode,
)
from tacshade_edge.protocol.serial.line import LINE_BYTES_MAX
from tacshade_edge.protocol.serial.pose import PoseSample, encode_pose

FULL = bytes(range(1, 255))
POSE = cobs_encode(encode_pose(PoseSample(1, 2, (0, 0, 0, 1, 0, 0, 0))))


@pytest.mark.parametrize(
    ("data", "encoded"),
    [  # the examples of the paper's readers: Wikipedia's table
        (b"\0", "0101"),
        (b"\0\0", "010101"),
        (b"\0\x11\0", "01021101"),
        (b"\x11\x22\0\x33", "0311220233"),
        (b"\x11\x22\x33\x44", "0511223344"),
        (b"\x11\0\0\0", "0211010101"),
        (FULL, "ff" + FULL.hex()),
        (b"\0" + FULL, "01ff" + FULL.hex()),
        (FULL + b"\xff", "ff" + FULL.hex() + "02ff"),
        (FULL + b"\0", "ff" + FULL.hex() + "0101"),
        (b"", "01"),
        (b"\x01", "0201"),
        (b"\x22\x01", "032201"),
    ],
)
def test_known_frames(data: bytes, encoded: str) -> None:
    assert cobs_encode(data).hex() == encoded
    assert cobs_decode(bytes.fromhex(encoded)) == data


@given(st.binary(max_size=600) | st.lists(st.sampled_from([b"\0", FULL, b"\x05" * 253]), max_size=5).map(b"".join))
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
    assert units(framing, b"STATUS\r\n\nHELP\r", chunk) == [Unit(b"STATUS", True), Unit(b"HELP", True)]
    framing.switch("BIN")
    assert units(framing, b"\x02a\0\0\x02b\0\x02", chunk) == [Unit(b"\x02a", False), Unit(b"\x02b", False)]
    assert framing.buffered_bytes == 1


@pytest.mark.parametrize(
    ("mode", "end", "longest"), [("ASCII", b"\n", LINE_BYTES_MAX), ("BIN", b"\0", FRAME_BYTES_MAX)]
)
def test_what_never_ends_is_not_kept_and_counted(mode: Mode, end: bytes, longest: int) -> None:
    counts = LinkCounts()
    framing = Framing(counts)
    framing.switch(mode)
    assert units(framing, b"x" * 10_000, 97) == []
    assert framing.buffered_bytes <= longest + 97
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


def test_half_a_line_is_forgotten_with_its_port() -> None:
    counts = LinkCounts()
    framing = Framing(counts)
    assert units(framing, b"STAT", 4) == []
    framing.clear()
    assert units(framing, b"US\n", 3) == [Unit(b"US", True)]
    assert (counts.garbage, counts.garbage_bytes) == (1, 4)
