"""The sensors that a bridge holds and the messages it refuses: any client of the broker can invent either."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final, Generic, TypeVar

from tacshade_edge.quoting import escaped

_log = logging.getLogger(__name__)

SENSORS_MAX: Final = 256
_SAID_MAX: Final = 256
_LINE_S: Final = 1.0
_CHARS_MAX: Final = 300
_ID_CHARS_MAX: Final = 100

T = TypeVar("T")


class Roster(Generic[T]):
    """At most `SENSORS_MAX` sensors; when it is full, a sensor of higher rank replaces the one of lowest rank.

    ``make(sensor_id)`` returns the value to hold for a new sensor; ``rank(value)`` how likely the sensor is real: the
    more it has published, the higher; ``close(value)`` is called when a sensor is dropped.
    """

    def __init__(
        self, make: Callable[[str], T], rank: Callable[[T], int], close: Callable[[T], None] = lambda _: None
    ) -> None:
        self._make, self._rank, self._close = make, rank, close
        self._sensors: dict[str, T] = {}

    def __iter__(self) -> Iterator[tuple[str, T]]:
        return iter(sorted(self._sensors.items(), key=lambda item: item[0]))

    def get(self, sensor_id: str) -> T | None:
        return self._sensors.get(sensor_id)

    def best(self, count: int) -> list[str]:
        """Return the names of the `count` sensors of highest rank; among equals, the earliest come first."""
        return sorted(self._sensors, key=lambda name: -self._rank(self._sensors[name]))[:count]

    def of(self, sensor_id: str, rank: int) -> T | None:
        """Return a sensor's value, None if there is no room; a new sensor enters with the `rank` of its message."""
        if sensor_id not in self._sensors:
            if len(self._sensors) >= SENSORS_MAX:
                least = min(self._sensors, key=lambda name: self._rank(self._sensors[name]))
                if self._rank(self._sensors[least]) >= rank:
                    return None
                self.drop(least)
            self._sensors[sensor_id] = self._make(sensor_id)
        return self._sensors[sensor_id]

    def drop(self, sensor_id: str) -> None:
        if (sensor := self._sensors.pop(sensor_id, None)) is not None:
            self._close(sensor)


class Refusals:
    """Counts refused messages by reason; logs a sensor's refusal when its text is new, at most one line a second."""

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._said: dict[str, str] = {}
        self._reported_s = float("-inf")
        self._unreported = 0
        self.counts: Counter[str] = Counter(undecodable=0, no_room=0, unknown_topic=0)

    def add(self, why: str, sensor_id: str, text: str) -> None:
        """Count a refusal; `why` is a key of `counts`. `sensor_id` may be any text."""
        self.counts[why] += 1
        sensor_id = escaped(sensor_id, _ID_CHARS_MAX)
        if self._said.get(sensor_id) == text:
            return
        if self._clock_s() - self._reported_s < _LINE_S:
            self._unreported += 1
            return
        if len(self._said) >= _SAID_MAX:
            self._said.clear()
        self._said[sensor_id] = text
        more = f" (earlier warnings that were not logged: {self._unreported})" if self._unreported else ""
        self._reported_s, self._unreported = self._clock_s(), 0
        _log.warning("%s: %s%s", sensor_id, escaped(text, _CHARS_MAX), more)
