"""One decoder for all JSON of a hand: what is beyond its bounds is refused in one line,
whatever it is.
"""

from __future__ import annotations

import contextlib
import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.capture.scale import parse_reading
from tacshade_edge.errors import DecodeError
from tacshade_edge.recording.mcap.ros_image import PixelRows, decode_compressed_image, decode_image
from tacshade_edge.wire import codec

HUGE = b"1" + b"0" * 400


@pytest.mark.parametrize(
    ("payload", "found"),
    [
        (b" " * (codec.BYTES_MAX + 1), "65537 bytes"),
        (b'{"a":' + HUGE + b"}", "more than 64 bits"),
        (b'{"a":-' + HUGE * 12 + b"}", "expected the format"),
        (b'{"a":1e999}', "expected the format"),
        (b'{"a":NaN}', "expected the format"),
        (b'{"a":' + b"[" * 10 + b"]" * 10 + b"}", "more than 9 levels"),
        (b"[" * 60_000, "expected the format"),
        (b'{"a":[' + b"0," * 20_000 + b"0]}", "more than 16384 values"),
        (b'{"a":"' + b"x" * 5000 + b'"}', "5000 characters"),
        (b'{"' + b"x" * 5000 + b'":0}', "5000 characters"),
        (b"\xff", "expected the format"),
        (b"", "expected the format"),
        (b'{"a":"\\ud800"}', "expected the format"),
        (b"\xef\xbb\xbf{}", "expected the format"),
        (b"[]", "got `array`"),
    ],
)
def test_what_is_out_of_bounds_is_one_line(payload: bytes, found: str) -> None:
    with pytest.raises(DecodeError, match=found) as refused:
        codec.decode_object("health", payload)
    assert str(refused.value).startswith("health: ")
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 400


def test_what_is_within_them_is_understood() -> None:
    value = {"a": [[[[[[0]]]]]], "b": 2**64, "c": -1.5e308, "d": "x" * 4096, "e": None}
    assert codec.decode_object("health", json.dumps(value).encode()) == value


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@pytest.mark.slow
@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_any_bytes_are_an_object_or_refused(payload: bytes) -> None:
    with contextlib.suppress(DecodeError):
        assert isinstance(codec.decode_object("x", payload), dict)


@pytest.mark.parametrize(
    ("line", "newtons"),
    [
        (b"1.5 N", 1.5),
        (b"-0,250 kg", -0.25 * 9.80665),
        (b"ST,GS,+  0.123kg\r", 0.123 * 9.80665),
        (b"US,NT,-00012.5  g", -0.0125 * 9.80665),
        (b"+ 100 g", 0.980665),
        (b"G     .5 g", 0.0005 * 9.80665),
        (b"16 oz", 4.4482216152605),
        (b"1 lbf", 4.4482216152605),
        (b"250 mN", 0.25),
        (b"N 12 pcs 30.0 G", 0.03 * 9.80665),
        (b"12.5", None),
        (b"9" * 250 + b" N", None),
        (b"-1000.1 kN", None),
        (b"12.5 pcs", None),
        (b"OL kg", None),
        (b"\xff\xfe", None),
        (b"", None),
    ],
)
def test_a_line(line: bytes, newtons: float | None) -> None:
    assert parse_reading(line) == (None if newtons is None else pytest.approx(newtons, rel=1e-9))


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
def test_an_image_of_any_alignment(
    order: str, frame_id: bytes, rows: int, cols: int, encoding: bytes
) -> None:
    found = decode_image(image(order, frame_id, rows, cols, encoding))
    assert found == PixelRows(rows, cols, encoding.decode(), cols, bytes(range(rows * cols)))


@given(st.sampled_from("<>"), names, names, st.binary(max_size=50))
def test_a_compressed_image(order: str, frame_id: bytes, kind: bytes, data: bytes) -> None:
    assert decode_compressed_image(cdr(order, 7, 8, frame_id + b"\0", kind + b"\0", data)) == data


def test_one_that_is_cut_anywhere_is_refused() -> None:
    whole = image("<", b"camera", 3, 4, b"mono8")
    for at in range(len(whole)):
        with pytest.raises(DecodeError, match="Expected a whole message"):
            decode_image(whole[:at])


@given(st.binary(max_size=200))
def test_any_bytes_are_an_image_or_refused(data: bytes) -> None:
    for decode in (decode_image, decode_compressed_image):
        with contextlib.suppress(DecodeError):
            decode(data)
