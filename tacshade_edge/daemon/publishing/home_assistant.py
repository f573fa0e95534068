"""Announces the sensor in Home Assistant if the settings want it, and withdraws it once they no longer do."""

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
    """Retained announcements outlive the daemon, and so does the status under its own topics that reports them.

    A daemon that must not announce withdraws what it finds announced by an earlier run. One that never announced writes
    nothing outside its own topics.

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
        """Announce the sensor if the settings want it and the profiles are new."""
        if not self._wanted or self._announced == tuple(profiles):
            return
        self._announced = tuple(profiles)
        for topic, payload in encode_discovery(self._sensor_id, version=installed_version(), profiles=profiles).items():
            self._link.set_retained(f"/{topic}", payload)
        self._link.set_retained(STATUS, encode_status(ANNOUNCED))

    def _withdraw(self, status: bytes) -> None:
        """Withdraw what an earlier run announced, according to its status."""
        try:
            state = decode_status(STATUS, status).state
        except DecodeError:
            return
        if state == ANNOUNCED:
            for topic in discovery_topics(self._sensor_id):
                self._link.set_retained(f"/{topic}", b"")
            self._link.set_retained(STATUS, encode_status(WITHDRAWN))
