"""Decode the JSON that a sensor published, strictly: anyone who reaches the broker may have written it."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import DecodeError
from ..quoting import escaped, quoted

T = TypeVar("T")
_Reader = Callable[[Any], Any]

BYTES_MAX: Final = 1 << 16
"""Ten times the largest `health` of a daemon."""
VALUES_MAX: Final = 1 << 14
DEPTH_MAX: Final = 9
CHARS_MAX: Final = 4096
"""The longest text accepted; the longest that a daemon publishes is a reason of a few hundred characters."""
_INTEGER_MAX: Final = 2**64
_ERROR_CHARS_MAX, _KEY_CHARS_MAX = 200, 60
_SURROGATE: Final = re.compile("[\ud800-\udfff]")


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds of an ``Annotated`` type.

    Attributes
    ----------
    least, most : float
        Range of a number's value, or of an array's or object's length.
    pattern : str or None
        Regular expression that the whole text must match.
    """

    least: float = -math.inf
    most: float = math.inf
    pattern: str | None = None


class _Mismatch(ValueError):
    """A value of the wrong kind; each enclosing reader prepends its key or index to `place`."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.place = ""

    def __str__(self) -> str:
        return f"${self.place} {self.args[0]}"


def _not(expected: str, value: Any) -> _Mismatch:
    match value:
        case dict():
            found = "an object"
        case list():
            found = "an array"
        case str():
            found = quoted(value)
        case _:
            found = json.dumps(value)
    return _Mismatch(f"is {found}, not {expected}")


def decode(what: str, payload: bytes, kind: type[T]) -> T:
    """Decode a payload as a `kind`; unknown keys are ignored, but the size limits apply to them too.

    Parameters
    ----------
    what : str
        The topic, for the error.
    payload : bytes
    kind : type
        A dataclass whose fields state their ranges (`Bounds`), or a type that such a field may have.

    Raises
    ------
    DecodeError
        The payload has more bytes, values, levels or characters than a daemon publishes, holds a number that is not
        finite, is not JSON, or is not a `kind`.
    """
    if len(payload) > BYTES_MAX:
        raise DecodeError(f"{what}: found {len(payload)} bytes, expected at most {BYTES_MAX}")
    try:
        value = json.loads(str(payload, "utf-8"), parse_constant=_no_constant)
        _check(value)
        whole: Any = kind  # otherwise mypy doubts that a type is hashable
        read: T = _reader(whole)(value)
    except (ValueError, RecursionError) as error:  # ValueError: no UTF-8, too many digits, a dataclass's own check
        raise DecodeError(
            f"{what}: {escaped(str(error), _ERROR_CHARS_MAX)}; expected the format in docs/reference/mqtt.md"
        ) from error
    return read


def decode_object(what: str, payload: bytes) -> dict[str, Any]:
    """Decode a payload as an object with any keys. Raises DecodeError as `decode` does."""
    return decode(what, payload, dict[str, Any])


def _no_constant(name: str) -> None:
    raise ValueError(f"found {name}, which JSON does not have")


def _check(value: Any) -> None:
    """Raise ValueError if a value exceeds the size limits."""
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
                case str():
                    _check_text(one)
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


def _check_text(text: str) -> None:
    if len(text) > CHARS_MAX:
        raise ValueError(f"found a text of {len(text)} characters, expected at most {CHARS_MAX}")
    if not text.isascii() and _SURROGATE.search(text):
        raise ValueError("found half of a character (a lone surrogate)")


# -- make the reader of a type, once per type -------------------------------------------------------------------------


@cache
def _reader(kind: Any) -> _Reader:
    """The function that converts a value from `json` to a `kind`, or raises _Mismatch."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return lambda value: value
    if origin is Annotated:
        return _bounded(_reader(arguments[0]), arguments[1])
    if origin is Literal:
        return _literal(arguments)
    if origin in (Union, UnionType):
        (other,) = (one for one in arguments if one is not NoneType)
        return _or_none(_reader(other))
    if origin is tuple:
        return _tuple(arguments)
    if origin is dict:
        return _dict(_reader(arguments[0]), _reader(arguments[1]))
    if kind is float:
        return _float
    return _dataclass(kind) if dataclasses.is_dataclass(kind) else _plain(kind)


def _float(value: Any) -> float:
    if type(value) not in (float, int):
        raise _not("a number", value)
    return float(value)


def _plain(kind: type) -> _Reader:
    expected = {int: "an integer", str: "a text", bool: "true or false"}[kind]

    def read(value: Any) -> Any:
        if type(value) is not kind:
            raise _not(expected, value)
        return value

    return read


def _literal(values: tuple[Any, ...]) -> _Reader:
    def read(value: Any) -> Any:
        if type(value) is not str or value not in values:
            raise _not(f"one of {', '.join(values)}", value)
        return value

    return read


def _or_none(reader: _Reader) -> _Reader:
    return lambda value: None if value is None else reader(value)


def _bounded(reader: _Reader, bounds: Bounds) -> _Reader:
    least, most = bounds.least, bounds.most
    pattern = re.compile(bounds.pattern) if bounds.pattern is not None else None

    def read(value: Any) -> Any:
        found = reader(value)
        if pattern is not None:
            if pattern.fullmatch(found) is None:
                raise _not(f"a text of the pattern {bounds.pattern}", value)
        elif not least <= (found if isinstance(found, int | float) else len(found)) <= most:
            subject = "" if isinstance(found, int | float) else "of length "
            raise _not(f"{subject}{_range(least, most)}", value)
        return found

    return read


def _range(least: float, most: float) -> str:
    if math.isinf(most):
        return f"{least:.15g} or more"
    return f"{most:.15g} or less" if math.isinf(least) else f"{least:.15g} to {most:.15g}"


def _tuple(kinds: tuple[Any, ...]) -> _Reader:
    readers = [_reader(one) for one in kinds if one is not ...]
    any_length = kinds[-1] is ...

    def read(value: Any) -> Any:
        if type(value) is not list:
            raise _not("an array", value)
        if not any_length and len(value) != len(readers):
            raise _not(f"of length {len(readers)}", value)
        found = []
        for at, one in enumerate(value):
            try:
                found.append(readers[0 if any_length else at](one))
            except _Mismatch as error:
                error.place = f"[{at}]{error.place}"
                raise
        return tuple(found)

    return read


def _dict(key_reader: _Reader, reader: _Reader) -> _Reader:
    def read(value: Any) -> Any:
        if type(value) is not dict:
            raise _not("an object", value)
        found = {}
        for key, one in value.items():
            try:
                found[key_reader(key)] = reader(one)
            except _Mismatch as error:
                error.place = f".{escaped(key, _KEY_CHARS_MAX)}{error.place}"
                raise
        return found

    return read


def _dataclass(kind: Any) -> _Reader:
    hints = get_type_hints(kind, include_extras=True)
    missing = dataclasses.MISSING
    fields = [
        (field.name, _reader(hints[field.name]), field.default is missing and field.default_factory is missing)
        for field in dataclasses.fields(kind)
    ]

    def read(value: Any) -> Any:
        if type(value) is not dict:
            raise _not("an object", value)
        found = {}
        for name, reader, required in fields:
            if name in value:
                try:
                    found[name] = reader(value[name])
                except _Mismatch as error:
                    error.place = f".{name}{error.place}"
                    raise
            elif required:
                raise _Mismatch(f"lacks the key {name}")
        return kind(**found)

    return read
