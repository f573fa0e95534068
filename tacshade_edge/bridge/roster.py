"""The sensors that a bridge holds and the messages it refuses:
any client of the broker can invent either.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final, Generic, TypeVar

from tacshade_edge.quoting import escaped

_log = logging.getLogger(__name__)

_CHARS_MAX: Final = 300
_ID_CHARS_MAX: Final = 100

T = TypeVar("T")


class Roster(Generic[T]):
    """At most `most` sensors; when it is full, one of higher `rank` replaces that of lowest rank,
    which is closed.
    """

    def __init__(
        self,
        most: int,
        make: Callable[[str], T],
        rank: Callable[[T], int],
        close: Callable[[T], None] = lambda _: None,
    ) -> None:
        self._most, self._make, self._rank, self._close = most, make, rank, close
        self._sensors: dict[str, T] = {}

    def __iter__(self) -> Iterator[tuple[str, T]]:
        return iter(sorted(self._sensors.items(), key=lambda item: item[0]))

    def get(self, sensor_id: str) -> T | None:
        return self._sensors.get(sensor_id)

    def of(self, sensor_id: str, rank: int) -> T | None:
        """Return a sensor's value, None if there is no room;
        a new sensor enters with the `rank` of its message.
        """
        if sensor_id not in self._sensors:
            if len(self._sensors) >= self._most:
                least = min(self._sensors, key=lambda name: self._rank(self._sensors[name]))
                # Of equal rank, the earlier stays: invented ones would take turns.
                if self._rank(self._sensors[least]) >= rank:
                    return None
                self.drop(least)
            self._sensors[sensor_id] = self._make(sensor_id)
        return self._sensors[sensor_id]

    def drop(self, sensor_id: str) -> None:
        if (sensor := self._sensors.pop(sensor_id, None)) is not None:
            self._close(sensor)


class Refusals:
    """Counts refused messages by reason, and logs the first, second, fourth, eighth and so on."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter(undecodable=0, no_room=0, unknown_topic=0)

    def add(self, why: str, sensor_id: str, text: str) -> None:
        """Count a refusal; `why` is a key of `counts`. `sensor_id` may be any text."""
        self.counts[why] += 1
        # A flood of millions takes twenty lines of the log.
        if (count := self.counts[why]).bit_count() == 1:
            shown = escaped(sensor_id, _ID_CHARS_MAX), escaped(text, _CHARS_MAX)
            _log.warning("%s: %s (%d such messages so far)", *shown, count)
