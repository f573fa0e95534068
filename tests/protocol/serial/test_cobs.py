from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial import cobs

FULL = bytes(range(1, 255))


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
    assert cobs.encode(data).hex() == encoded
    assert cobs.decode(bytes.fromhex(encoded)) == data


@given(st.binary(max_size=600) | st.lists(st.sampled_from([b"\0", FULL, b"\x05" * 253]), max_size=5).map(b"".join))
def test_every_frame_comes_back_and_has_no_zero(data: bytes) -> None:
    encoded = cobs.encode(data)
    assert b"\0" not in encoded
    assert len(encoded) <= len(data) + 1 + len(data) // 254
    assert cobs.decode(encoded) == data


def test_all_frames_of_two_bytes() -> None:
    for number in range(65536):
        data = number.to_bytes(2, "big")
        assert cobs.decode(cobs.encode(data)) == data


@pytest.mark.parametrize("wrong", ["05112233", "0311002202", "ff01"])
def test_a_cut_frame_or_one_with_a_zero_is_refused(wrong: str) -> None:
    with pytest.raises(DecodeError, match="COBS"):
        cobs.decode(bytes.fromhex(wrong))
