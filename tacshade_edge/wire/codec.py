"""The codec of all JSON that sensors publish: a message's type states its fields and their bounds
(`msgspec.Meta`).

Anyone who reaches the broker may have written a payload, so decoding limits its size, and unknown
keys are ignored only within these limits.
"""

from __future__ import annotations

from typing import Any, Final, TypeVar

import msgspec
import numpy as np

from ..errors import DecodeError
from ..quoting import escaped

T = TypeVar("T")

BYTES_MAX: Final = 1 << 16
"""Ten times the largest `health` of a daemon."""
VALUES_MAX: Final = 1 << 14
DEPTH_MAX: Final = 9
CHARS_MAX: Final = 4096
"""The longest text accepted; the longest that a daemon publishes is a reason
of a few hundred characters.
"""
_INTEGER_MAX: Final = 2**64
_ERROR_CHARS_MAX: Final = 200


def encode_json(value: object) -> bytes:
    """Encode a message; NaN and infinity, which JSON lacks, become null."""
    return msgspec.json.encode(value, enc_hook=_plain)


def _plain(value: object) -> object:
    """Convert a numpy number to a Python number."""
    # Results are numpy's numbers here and there, which msgspec does not know.
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form here")


def decode_json(what: str, payload: bytes, kind: type[T]) -> T:
    """Decode the payload of the topic `what` as a `kind`; unknown keys are ignored.

    Raises DecodeError if the payload has more bytes, values, levels or characters than a daemon
    publishes, holds a number that is not finite, is not JSON, or is not a `kind`.
    """
    if len(payload) > BYTES_MAX:
        raise DecodeError(f"{what}: found {len(payload)} bytes, expected at most {BYTES_MAX}")
    try:
        # First without a type: with one, msgspec skips unknown keys, whatever they contain, and the
        # limits hold for them too.
        value = msgspec.json.decode(payload)
        _check(value)
        return msgspec.convert(value, kind)
    except (
        # msgspec's errors are ValueErrors, as is UnicodeDecodeError. Brackets alone nest deep
        # enough for a RecursionError.
        ValueError,
        RecursionError,
    ) as error:
        raise DecodeError(
            f"{what}: {escaped(str(error), _ERROR_CHARS_MAX)}; expected the format in "
            "docs/reference/mqtt.md"
        ) from error


def decode_object(what: str, payload: bytes) -> dict[str, Any]:
    """Decode a payload as an object with any keys. Raises DecodeError as `decode_json` does."""
    return decode_json(what, payload, dict[str, Any])


def _check(value: object, level: int = 0) -> int:
    """Return how many values a value holds. Raises ValueError if it exceeds the limits."""
    inside: list[object] = []
    match value:
        case dict():
            inside = [*value, *value.values()]
        case list():
            inside = value
        case str() if len(value) > CHARS_MAX:
            raise ValueError(
                f"found a text of {len(value)} characters, expected at most {CHARS_MAX}"
            )
        # msgspec reads integers of any length, which no other language's subscriber could.
        case int() if abs(value) > _INTEGER_MAX:
            raise ValueError("found an integer of more than 64 bits")
    # Before the recursion, whose depth this bounds.
    if inside and level == DEPTH_MAX:
        raise ValueError(f"found more than {DEPTH_MAX} levels")
    count = len(inside) + sum(_check(one, level + 1) for one in inside)
    if count > VALUES_MAX:
        raise ValueError(f"found more than {VALUES_MAX} values")
    return count
