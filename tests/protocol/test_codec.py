"""One decoder for all JSON of a hand: what is beyond its bounds is refused in one line, whatever it is."""

from __future__ import annotations

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import codec

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
