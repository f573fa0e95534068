"""The one way to understand JSON that a sensor published: whoever reaches the broker may have written it."""

from __future__ import annotations

import math
from typing import Any, Final, TypeVar

import msgspec

from tacshade_edge.errors import DecodeError
from tacshade_edge.quoting import escaped

T = TypeVar("T")

BYTES_MAX: Final = 1 << 16
"""Ten times the largest `health` of a daemon."""
VALUES_MAX: Final = 1 << 14
DEPTH_MAX: Final = 9
CHARS_MAX: Final = 4096
"""Of a text; the longest that a daemon publishes is a reason of a few hundred."""
_INTEGER_MAX: Final = 2**64
_ERROR_CHARS_MAX: Final = 200


def decode(what: str, payload: bytes, kind: type[T]) -> T:
    """Understand a payload as a `kind`; keys that it does not have are ignored, but within the bounds too.

    Parameters
    ----------
    what : str
        The topic, for the error.
    payload : bytes
    kind : type
        Its ranges are its own.

    Raises
    ------
    DecodeError
        More bytes, values, levels or characters than a daemon publishes, a number that is none, not JSON, or no `kind`.
    """
    if len(payload) > BYTES_MAX:
        raise DecodeError(f"{what}: {len(payload)} bytes, expected at most {BYTES_MAX}")
    try:
        value = msgspec.json.decode(payload)
        _check(value)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:  # ValueError: no UTF-8, too many digits
        raise _refused(what, error) from error
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise _refused(what, error) from error


def decode_object(what: str, payload: bytes) -> dict[str, Any]:
    """Understand a payload as an object of any keys. Raises DecodeError as `decode`."""
    return decode(what, payload, dict[str, Any])


def _refused(what: str, error: Exception) -> DecodeError:
    return DecodeError(f"{what}: {escaped(str(error), _ERROR_CHARS_MAX)}, expected what docs/reference/mqtt.md says")


def _check(value: Any) -> None:
    """Raise ValueError for what is out of all bounds."""
    level, count = [value], 0
    for _ in range(DEPTH_MAX + 1):
        below: list[Any] = []
        for one in level:
            match one:
                case dict():
                    below += one.keys()
                    below += one.values()
                case list():
                    below += one
                case str() if len(one) > CHARS_MAX:
                    raise ValueError(f"found a text of {len(one)} characters, at most {CHARS_MAX} are taken")
                case int() if abs(one) > _INTEGER_MAX:
                    raise ValueError("found an integer of more than 64 bits")
                case float() if not math.isfinite(one):
                    raise ValueError("found a number beyond all floats")
        count += len(below)
        if count > VALUES_MAX:
            raise ValueError(f"found more than {VALUES_MAX} values")
        if not below:
            return
        level = below
    raise ValueError(f"found more than {DEPTH_MAX} levels")
