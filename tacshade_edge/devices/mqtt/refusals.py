"""Topics that the broker rejects, logged once: rejections continue until somebody fixes the broker's rules."""

from __future__ import annotations

import logging

_log = logging.getLogger(__name__)


class Refusals:
    """The topics that are rejected now. It has no lock: its owner guards it. `where`: name of the broker in the log."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._topics: set[str] = set()

    def refused(self, topic: str, why: str) -> None:
        """Record a rejected message or subscription to a topic; log the first."""
        if not self._topics:
            _log.warning("%s: rejects %s: %s; further rejections are not logged", self._where, topic, why)
        self._topics.add(topic)

    def taken(self, topic: str) -> None:
        """Record an accepted one; log the end of all rejections."""
        if topic in self._topics:
            self._topics.remove(topic)
            if not self._topics:
                _log.info("%s: no longer rejects any topic", self._where)
