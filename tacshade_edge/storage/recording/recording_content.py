"""A recording's content other than frames: files in its folder, or attachments in its MCAP file."""

from __future__ import annotations

import errno
import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeGuard

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular
from tacshade_edge.storage.atomic_files import part
from tacshade_edge.storage.recording.mcap import is_mcap, require_mcap
from tacshade_edge.storage.tables.frame_table import T_NS_MAX

_log = logging.getLogger(__name__)

CALIBRATION_NAME, SETTINGS_NAME, EVENTS_NAME = "calibration.npz", "settings.yaml", "events.jsonl"
ABOUT_NAME: Final = "recording.json"
_BYTES_MAX: Final = {CALIBRATION_NAME: 64 << 20, SETTINGS_NAME: 1 << 20, EVENTS_NAME: 8 << 20, ABOUT_NAME: 1 << 20}
_LINE_BYTES_MAX: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Event:
    """A recorded event; `t_ns` is on the frames' clock."""

    t_ns: int
    kind: str
    data: dict[str, Any]


def content_of(recording: Path) -> dict[str, bytes]:
    """The calibration, settings, events and ``recording.json`` by name, as far as they exist.

    The log reports damaged or too large attachments of an MCAP file, which are left out. Raises ConfigError if an MCAP
    file is not MCAP, or a file is too large.
    """
    if not recording.is_dir() and is_mcap(recording):
        require_mcap()
        from tacshade_edge.storage.recording.mcap.reader import attachments_in

        attached, damage = attachments_in(recording, _BYTES_MAX)
        for line in damage:
            _log.warning("%s", line)
        return attached
    found = {name: data for name in _BYTES_MAX if (data := _read(recording / name)) is not None}
    unfinished = _read(part(recording / EVENTS_NAME))
    return found if EVENTS_NAME in found or unfinished is None else found | {EVENTS_NAME: unfinished}


def events_in(content: dict[str, bytes]) -> Iterator[Event]:
    """The events in order; lines that are not events are skipped."""
    for line in content.get(EVENTS_NAME, b"").splitlines():
        if len(line) > _LINE_BYTES_MAX:
            continue
        try:
            found = json.loads(line)
            event = Event(found["t_ns"], found["kind"], found["data"])
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
        if _is_time(event.t_ns) and isinstance(event.kind, str) and isinstance(event.data, dict):
            yield event


def wall_minus_t_ns(folder: Path) -> int:
    """Unix time minus the frames' clock in ns; 0 if the recording does not state it."""
    content = {name: data for name in (ABOUT_NAME, EVENTS_NAME) if (data := _read(folder / name)) is not None}
    try:
        about = json.loads(content.get(ABOUT_NAME, b"{}"))
        wall_ns, t_ns = about["first_wall_ns"], about["first_t_ns"]
        if _is_time(wall_ns) and _is_time(t_ns):
            return wall_ns - t_ns
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    unfinished = _read(part(folder / EVENTS_NAME))
    for event in events_in({EVENTS_NAME: unfinished or content.get(EVENTS_NAME, b"")}):
        if _is_time(wall_ns := event.data.get("wall_ns")):
            return wall_ns - event.t_ns
    return 0


def _is_time(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= T_NS_MAX


def _read(path: Path) -> bytes | None:
    bytes_max = _BYTES_MAX[path.name.removesuffix(".part")]
    try:
        return read_regular(path, bytes_max)
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise ConfigError(f"{shown(path)}: {error.strerror}") from None
        return None
