"""Keeps how the sensor looked at rest, once on each day, and says what ages."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tacshade_edge.calibration.ageing.appearance import appearance
from tacshade_edge.calibration.ageing.wears import (
    DAY_MAX,
    LIMITS,
    UNITS,
    History,
    Wear,
    date_of,
    judge,
    words,
)
from tacshade_edge.calibration.files import ageing_file
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.types import U8, Calibration

_log = logging.getLogger(__name__)
_DAY_S = 86400


class AgeingWatch:
    """The history of one calibration. `reason` is why it does not grow."""

    def __init__(self, calibrated: Calibration, path: Path) -> None:
        self._calibrated, self._path = calibrated, path
        self._history: History | None = None
        self.reason: Reason | None = None
        try:
            self._history = ageing_file.load(path, calibrated)
        except ConfigError as error:
            # A person may want to save what is left of it, so nothing is written over it.
            _log.warning("%s", error)
            self.reason = error.reason
        self._wears = judge(self._history) if self._history else ()
        self._named = {wear.kind for wear in self._wears if wear.named}

    def see(self, images: Sequence[U8], *, owned: bool) -> None:
        """Take untouched images; the first ones of a day count. Only the daemon that owns the
        calibration's folder writes.
        """
        day, history = int(time.time()) // _DAY_S, self._history
        if history is None or not owned or not 0 <= day <= DAY_MAX:
            return
        last = history.last_day
        if last is not None and day <= last:
            self.reason = _earlier(self._path, last) if day < last else None
            return
        look = appearance(self._calibrated, images)
        if look is None:
            return
        self._history = history.with_day(day, look)
        self._wears, self.reason = judge(self._history), None
        try:
            ageing_file.save(self._path, self._calibrated, self._history)
        except DeviceError as error:
            _log.warning("%s; this day of the sensor's history is lost at the next start", error)
            self.reason = error.reason
        self._report()

    def health(self) -> dict[str, Any]:
        """Its content for ``health``."""
        days = 0 if self._history is None else len(self._history.days)
        return {
            "days": days,
            "ageing": [wear.kind for wear in self._wears if wear.named],
            "wears": {wear.kind: _figures(wear) for wear in self._wears},
            **reason_fields(self.reason),
        }

    def _report(self) -> None:
        """Log what is newly named."""
        named = {wear.kind: wear for wear in self._wears if wear.named}
        for kind, wear in named.items():
            if kind not in self._named:
                _log.warning("the sensor ages: %s", words(wear))
        self._named = set(named)


def _figures(wear: Wear) -> dict[str, Any]:
    per_year = wear.per_year
    return {
        "amount": round(wear.amount, 4),
        "limit": LIMITS[wear.kind],
        "unit": UNITS[wear.kind],
        "per_year": None if per_year is None else round(per_year, 4),
        "until": None if wear.limit_day is None else date_of(wear.limit_day),
    }


def _earlier(path: Path, last: int) -> Reason:
    text = (
        f"the clock shows a day before {date_of(last)}, the last one in {path}: set the clock, or "
        "delete that file if the clock was wrong then"
    )
    return Reason(ReasonCode.CLOCK_WENT_BACK, text)
