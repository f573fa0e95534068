"""What the broker does not take of us, reported once: it goes on for as long as nobody fixes the broker's rules."""

from __future__ import annotations

import logging

_log = logging.getLogger(__name__)


class Refusals:
    """Topics that are refused now. Not locked: its owner guards it.

    Parameters
    ----------
    where : str
        The broker, for the log.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._topics: set[str] = set()

    def refused(self, topic: str, why: str) -> None:
        """A message to a topic, or a subscription to it, was refused; the first one is logged."""
        if not self._topics:
            _log.warning("%s: rejects %s: %s; further rejections are not logged", self._where, topic, why)
        self._topics.add(topic)

    def taken(self, topic: str) -> None:
        """One was taken; the end of all refusals is logged."""
        if topic in self._topics:
            self._topics.remove(topic)
            if not self._topics:
                _log.info("%s: no longer rejects any topic", self._where)
