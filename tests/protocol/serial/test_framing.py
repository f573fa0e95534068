from __future__ import annotations

import pytest

from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.counts import LinkCounts
from tacshade_edge.protocol.serial.framing import FRAME_BYTES_MAX, Framing, Unit
from tacshade_edge.protocol.serial.line import LINE_BYTES_MAX
from tacshade_edge.protocol.serial.modes import Mode
from tacshade_edge.protocol.serial.pose import PoseSample, encode_pose

POSE = cobs.encode(encode_pose(PoseSample(1, 2, (0, 0, 0, 1, 0, 0, 0))))


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
