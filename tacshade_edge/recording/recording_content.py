"""A recording's content other than frames: files in its folder, or attachments in its MCAP file."""

from __future__ import annotations

import errno
import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import msgspec
from msgspec import Meta

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import part
from tacshade_edge.quoting import shown
from tacshade_edge.recording.frame_table import T_NS_MAX
from tacshade_edge.recording.mcap import is_mcap, require_mcap
from tacshade_edge.regular_files import read_regular

_log = logging.getLogger(__name__)
T = TypeVar("T")

CALIBRATION_NAME, SETTINGS_NAME, EVENTS_NAME = "calibration.npz", "settings.yaml", "events.jsonl"
ABOUT_NAME: Final = "recording.json"
EVENTS_BYTES_MAX: Final = 32 << 20
"""Most bytes of events that are read, and so written: 9 kB a second in the longest recording."""
_BYTES_MAX: Final = {
    CALIBRATION_NAME: 64 << 20,
    SETTINGS_NAME: 1 << 20,
    EVENTS_NAME: EVENTS_BYTES_MAX,
    ABOUT_NAME: 1 << 20,
}
# Hostile JSON takes many times its size once parsed.
_LINE_BYTES_MAX: Final = 1 << 16


_Time = Annotated[int, Meta(ge=0, le=T_NS_MAX)]


class Event(msgspec.Struct, frozen=True):
    """A recorded event; `t_ns` is on the frames' clock."""

    t_ns: _Time
    kind: str
    data: dict[str, Any]


class _Clocks(msgspec.Struct):
    """The same instant in Unix time and on the frames' clock."""

    first_wall_ns: _Time
    first_t_ns: _Time


def content_of(recording: Path) -> dict[str, bytes]:
    """The calibration, settings, events and ``recording.json`` by name, as far as they exist.

    The log reports attachments of an MCAP file that are damaged or too large.
    Raises ConfigError if another file is.
    """
    if not recording.is_dir() and is_mcap(recording):
        require_mcap()
        from tacshade_edge.recording.mcap.reader import attachments_in

        attached, damage = attachments_in(recording, _BYTES_MAX)
        for line in damage:
            _log.warning("%s", line)
        return attached
    found = {name: data for name in _BYTES_MAX if (data := _read(recording / name)) is not None}
    # A recorder that died, or still records, has not renamed them.
    unfinished = _read(part(recording / EVENTS_NAME))
    return (
        found if EVENTS_NAME in found or unfinished is None else found | {EVENTS_NAME: unfinished}
    )


def events_in(content: dict[str, bytes]) -> Iterator[Event]:
    """The events in order; lines that are not events are skipped."""
    for line in content.get(EVENTS_NAME, b"").splitlines():
        if len(line) <= _LINE_BYTES_MAX and (event := _known(line, Event)):
            yield event


def wall_minus_t_ns(folder: Path) -> int:
    """Unix time minus the frames' clock in ns; 0 if the recording does not state it."""
    # `recording.json` is written last; before, the event `start` has both clocks.
    about = _known(_read(folder / ABOUT_NAME) or b"", _Clocks)
    lines = _read(part(folder / EVENTS_NAME)) or _read(folder / EVENTS_NAME) or b""
    begun = (
        _known({"first_wall_ns": event.data.get("wall_ns"), "first_t_ns": event.t_ns}, _Clocks)
        for event in events_in({EVENTS_NAME: lines})
    )
    clocks = about or next(filter(None, begun), None)
    return 0 if clocks is None else clocks.first_wall_ns - clocks.first_t_ns


def _known(given: bytes | dict[str, Any], kind: type[T]) -> T | None:
    """JSON as a record; None if it is none."""
    try:
        return msgspec.convert(json.loads(given) if isinstance(given, bytes) else given, kind)
    except (ValueError, RecursionError):  # the latter for JSON of a thousand levels
        return None


def _read(path: Path) -> bytes | None:
    bytes_max = _BYTES_MAX[path.name.removesuffix(".part")]
    try:
        return read_regular(path, bytes_max)
    except OSError as error:
        # A recording need not have each of them, but one that is too large must not go unnoticed.
        if error.errno == errno.EFBIG:
            raise ConfigError(f"{shown(path)}: {error.strerror}") from None
        return None
