"""Checks what has aged on the sensor, by the history that a running daemon keeps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from tacshade_edge.calibration.ageing.wears import (
    RECENT,
    Kind,
    date_of,
    judge,
    shown,
    words,
)
from tacshade_edge.calibration.files import ageing_file
from tacshade_edge.doctor import Findings, ok, warning
from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import counted
from tacshade_edge.types import Calibration

_MORE = "(docs/how-to/ageing.md)"
_FIXES: Final[Mapping[Kind, str]] = {
    "light": f"restore the lamps or source.exposure, then calibrate --rezero {_MORE}",
    "markers": (
        f"clean the lens; if the markers have faded, replace the skin and calibrate again {_MORE}"
    ),
    "pins": (
        "if nothing rests on the skin there, pins have bent or come off: calibrate --rezero, or "
        f"replace the skin {_MORE}"
    ),
    "gel": f"look for a leak, refill or replace the skin, and calibrate again {_MORE}",
}


def check_ageing(path: Path, calibration: Calibration) -> Findings:
    """Judge the history in a file, of a calibration as in its file; nothing without a history."""
    try:
        history = ageing_file.load(path, calibration)
    except ConfigError as error:
        return (warning("ageing", str(error), f"move {path} away; the daemon begins another"),)
    if not len(history.days):
        return ()
    wears = judge(history)
    if named := [wear for wear in wears if wear.named]:
        return tuple(warning("ageing", words(wear), _FIXES[wear.kind]) for wear in named)
    since = f"{counted(len(history.days), 'day')} since {date_of(int(history.days[0]))}"
    if not wears:
        return (ok("ageing", f"{since} with a look at rest; judged from {RECENT} on"),)
    far = ", ".join(f"{wear.kind} {shown(wear.kind, wear.amount)}" for wear in wears)
    return (ok("ageing", f"nothing wears, by {since} with a look at rest: {far}"),)
