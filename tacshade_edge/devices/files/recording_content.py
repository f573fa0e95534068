"""What lies beside the frames of a recording: in its folder, or as attachments in its MCAP file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from tacshade_edge.devices.files.mcap import is_mcap, require_mcap
from tacshade_edge.devices.files.whole_files import part
from tacshade_edge.regular_files import read_regular

CALIBRATION_NAME, SETTINGS_NAME, EVENTS_NAME = "calibration.npz", "settings.yaml", "events.jsonl"
ABOUT_NAME: Final = "recording.json"
_BYTES_MAX: Final = 256 << 20


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, on the clock of the frames."""

    t_ns: int
    kind: str
    data: dict[str, Any]


def content_of(recording: Path) -> dict[str, bytes]:
    """Calibration, settings, events and ``recording.json``: those that are there, by name.

    Raises
    ------
    ConfigError
        An MCAP file that is none.
    """
    if not recording.is_dir() and is_mcap(recording):
        require_mcap()
        from tacshade_edge.devices.files.mcap.frames import attachments_of

        return attachments_of(recording)
    names = (CALIBRATION_NAME, SETTINGS_NAME, EVENTS_NAME, ABOUT_NAME)
    found = {name: data for name in names if (data := _read(recording / name)) is not None}
    unfinished = _read(part(recording / EVENTS_NAME))
    return found if EVENTS_NAME in found or unfinished is None else found | {EVENTS_NAME: unfinished}


def events_in(content: dict[str, bytes]) -> Iterator[Event]:
    """The events in order; a line that is none is passed over."""
    for line in content.get(EVENTS_NAME, b"").splitlines():
        try:
            found = json.loads(line)
            event = Event(found["t_ns"], found["kind"], found["data"])
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
        if isinstance(event.t_ns, int) and isinstance(event.kind, str) and isinstance(event.data, dict):
            yield event


def wall_minus_t_ns(folder: Path) -> int:
    """Unix time minus the clock of the frames; 0 where nothing tells it."""
    content = {name: data for name in (ABOUT_NAME, EVENTS_NAME) if (data := _read(folder / name)) is not None}
    try:
        about = json.loads(content.get(ABOUT_NAME, b"{}"))
        return int(about["first_wall_ns"]) - int(about["first_t_ns"])
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    unfinished = _read(part(folder / EVENTS_NAME))
    for event in events_in({EVENTS_NAME: unfinished or content.get(EVENTS_NAME, b"")}):
        if isinstance(wall_ns := event.data.get("wall_ns"), int):
            return wall_ns - event.t_ns
    return 0


def _read(path: Path) -> bytes | None:
    try:
        return read_regular(path, _BYTES_MAX)
    except OSError:
        return None
