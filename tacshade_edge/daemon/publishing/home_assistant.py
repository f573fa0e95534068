"""The sensor in Home Assistant: announced where the settings say so, and taken back where they no longer do."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.home_assistant import discovery_topics, encode_discovery
from tacshade_edge.protocol.messages import encode_status
from tacshade_edge.protocol.received import decode_status
from tacshade_edge.version import installed_version

STATUS = "status/home_assistant"
ANNOUNCED, WITHDRAWN = "announced", "withdrawn"


class HomeAssistant:
    """Retained announcements outlive the daemon; so does the status below its own topics that reports them.

    A daemon that finds that of an earlier run, and shall not announce, takes them back. One that never announced
    writes nothing outside its own topics.

    Parameters
    ----------
    link : MqttLink
        Not started.
    sensor_id : str
    wanted : bool
    """

    def __init__(self, link: MqttLink, sensor_id: str, *, wanted: bool) -> None:
        self._link, self._sensor_id, self._wanted = link, sensor_id, wanted
        self._announced: tuple[str, ...] | None = None
        if not wanted:
            link.watch(STATUS, self._withdraw)

    def announce(self, profiles: Sequence[str]) -> None:
        """Say what there is, where it is wanted and new."""
        if not self._wanted or self._announced == tuple(profiles):
            return
        self._announced = tuple(profiles)
        for topic, payload in encode_discovery(self._sensor_id, version=installed_version(), profiles=profiles).items():
            self._link.set_retained(f"/{topic}", payload)
        self._link.set_retained(STATUS, encode_status(ANNOUNCED))

    def _withdraw(self, status: bytes) -> None:
        """What an earlier run said of itself."""
        try:
            state = decode_status(STATUS, status).state
        except DecodeError:
            return
        if state == ANNOUNCED:
            for topic in discovery_topics(self._sensor_id):
                self._link.set_retained(f"/{topic}", b"")
            self._link.set_retained(STATUS, encode_status(WITHDRAWN))
