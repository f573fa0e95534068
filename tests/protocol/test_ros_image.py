from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.ros_image import PixelRows, decode_compressed_image, decode_image


def cdr(order: str, *values: bytes | int) -> bytes:
    """Texts and bytes with their length, and numbers, aligned to 4."""
    out = bytearray(b"\0\1\0\0" if order == "<" else b"\0\0\0\0")
    for value in values:
        out += b"\0" * (-len(out) % 4)
        out += struct.pack(f"{order}I", value if isinstance(value, int) else len(value))
        out += b"" if isinstance(value, int) else value
    return bytes(out)


def image(order: str, frame_id: bytes, rows: int, cols: int, encoding: bytes) -> bytes:
    head = cdr(order, 7, 8, frame_id + b"\0", rows, cols, encoding + b"\0")
    head += b"\0"  # is_bigendian
    head += b"\0" * (-len(head) % 4) + struct.pack(f"{order}I", cols)
    return head + struct.pack(f"{order}I", rows * cols) + bytes(range(rows * cols))


names = st.text("abc_8", max_size=9).map(str.encode)


@given(st.sampled_from("<>"), names, st.integers(0, 12), st.integers(0, 12), names)
def test_an_image_of_any_alignment(order: str, frame_id: bytes, rows: int, cols: int, encoding: bytes) -> None:
    found = decode_image(image(order, frame_id, rows, cols, encoding))
    assert found == PixelRows(rows, cols, encoding.decode(), cols, bytes(range(rows * cols)))


@given(st.sampled_from("<>"), names, names, st.binary(max_size=50))
def test_a_compressed_image(order: str, frame_id: bytes, kind: bytes, data: bytes) -> None:
    assert decode_compressed_image(cdr(order, 7, 8, frame_id + b"\0", kind + b"\0", data)) == data


def test_one_that_is_cut_anywhere_is_refused() -> None:
    whole = image("<", b"camera", 3, 4, b"mono8")
    for at in range(len(whole)):
        with pytest.raises(DecodeError, match=r"cut short|expected a CDR header"):
            decode_image(whole[:at])


@given(st.binary(max_size=200))
def test_any_bytes_are_an_image_or_refused(data: bytes) -> None:
    for decode in (decode_image, decode_compressed_image):
        with contextlib.suppress(DecodeError):
            decode(data)
