"""Serves the counters and rates that sensors publish as Prometheus metrics."""

from __future__ import annotations

import re
import socketserver
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from http.server import ThreadingHTTPServer
from typing import Any, Final, Literal

from prometheus_client import CollectorRegistry, Metric, MetricsHandler
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from tacshade_edge.bridge.roster import Refusals, Roster
from tacshade_edge.errors import DecodeError
from tacshade_edge.listening_socket import Connections, ListeningSocket
from tacshade_edge.wire.health_topics import Health
from tacshade_edge.wire.sensor_topics import Contact
from tacshade_edge.wire.topics import (
    ALIVE,
    STATES,
    State,
    decode_contact,
    decode_contact_event,
    decode_health,
    decode_state,
)

# Five are missed before an alert: a busy network delays one or two.
FRESH_S: Final = 5.0
"""Age at which a sensor's `health` or `contact`, published at least once a second, is out of
date.
"""

SENSORS_MAX: Final = 256
CONNECTIONS_MAX: Final = 16
"""Limit on connections, each of which has a thread; further ones are closed at once."""
_SPEAK_S: Final = 5.0
# How late it may end; the default is 0.5 s.
_POLL_S: Final = 0.1
_TOPIC: Final = re.compile(r"tacshade/([A-Za-z0-9_-]{1,64})/(state|health|contact|event/contact)")
# Prometheus wants base units.
_S_PER_MS: Final = 0.001
_M_PER_MM: Final = 0.001


@dataclass(slots=True)
class _Sensor:
    state: State | Literal[""] = ""
    health: Health | None = None
    heard_s: float = float("-inf")
    framed_s: float = float("-inf")
    """When the number of captured frames was last heard to have changed."""
    has_health: bool = False
    contact: Contact | None = None
    touched_s: float = float("-inf")
    """When `contact` was heard."""
    contacts: int = 0
    """How many have begun since the sensor is known."""


class SensorMetrics:
    """The latest states and counters of some sensors, or all that publish, and their contacts if
    `contact`, which makes them compute each frame: a collector for a `CollectorRegistry`.
    """

    def __init__(
        self,
        sensors: list[str],
        clock_s: Callable[[], float] = time.monotonic,
        *,
        contact: bool = False,
    ) -> None:
        self._clock_s, self._contact = clock_s, contact
        self.topics = {
            f"tacshade/{sensor_id}/{name}"
            for sensor_id in sensors or ["+"]
            for name in ("state", "health", *(("contact", "event/contact") if contact else ()))
        }
        self._lock = threading.Lock()
        self._sensors: Roster[_Sensor] = Roster(SENSORS_MAX, lambda _: _Sensor(), self._rank)
        self._refusals = Refusals()

    def hear(self, topic: str, payload: bytes, retained: bool) -> None:
        """Process a message from the broker.

        A retained `health` may be old: it only shows that the sensor has one.
        """
        with self._lock:
            if not (found := _TOPIC.fullmatch(topic)):
                self._refusals.add(
                    "unknown_topic", topic, "ignoring this topic, which is no sensor's"
                )
                return
            sensor_id, name = found.groups()
            try:
                if payload and name in ("contact", "event/contact"):
                    self._hear_contact(sensor_id, name, payload)
                elif payload:
                    self._hear(sensor_id, name, payload, retained=retained)
                elif name == "state":
                    self._sensors.drop(sensor_id)
            except DecodeError as error:
                self._refusals.add("undecodable", sensor_id, str(error))

    def collect(self) -> Iterator[Metric]:
        """Yield all current metrics; of a silent or stopped sensor only whether it is up
        and its state.
        """
        # The lock covers only a copy: a slow scrape must not hold up paho's thread.
        with self._lock:
            sensors = list(self._sensors)
            refused = dict(self._refusals.counts)
            fresh = {
                name: sensor.health
                for name, sensor in sensors
                if sensor.health and self._is_alive(sensor)
            }
            framed = {name for name, one in sensors if self._is_recent(one.framed_s)}
            touches = [
                (name, one.contact if self._is_recent(one.touched_s) else None, one.contacts)
                for name, one in sensors
                if name in fresh
            ]
        refusals = CounterMetricFamily(
            "tacshade_bridge_refused",
            "Messages that the bridge left out, by reason",
            labels=["why"],
        )
        for why, count in refused.items():
            refusals.add_metric([why], count)
        yield from (*_state_families(sensors, fresh), refusals)
        if self._contact:
            yield from _contact_families(touches)
        for kind, name, text, labels, samples in _OF_HEALTH:
            family = kind(f"tacshade_{name}", text, labels=["sensor", *labels])
            for sensor_id, health in fresh.items():
                # Without frames, what the last ones were like is not how they are.
                if name in _OF_LATEST_FRAMES and sensor_id not in framed:
                    continue
                for values, number in samples(health).items():
                    family.add_metric([sensor_id, *values], number)
            yield family

    def _hear(self, sensor_id: str, name: str, payload: bytes, *, retained: bool) -> None:
        # Decoded first: what is malformed must not make room for itself.
        state = decode_state(payload) if name == "state" else None
        health = decode_health(payload) if name == "health" else None
        rank = 0 if health is None else 1 if retained else 2
        if (sensor := self._sensors.of(sensor_id, rank)) is None:
            why = f"ignoring this sensor: {SENSORS_MAX} are already reported, the limit"
            self._refusals.add("no_room", sensor_id, why)
            return
        sensor.state = state or sensor.state
        sensor.has_health |= health is not None
        if health is not None and not retained:
            known = sensor.health
            if known is None or known.frames.get("captured") != health.frames.get("captured"):
                sensor.framed_s = self._clock_s()
            sensor.health, sensor.heard_s = health, self._clock_s()

    def _hear_contact(self, sensor_id: str, name: str, payload: bytes) -> None:
        contact = decode_contact(payload) if name == "contact" else None
        begins = name == "event/contact" and decode_contact_event(payload).type == "new"
        # It makes no room for a sensor, which is known by its state and health.
        if (sensor := self._sensors.get(sensor_id)) is None:
            return
        sensor.contacts += begins
        if contact is not None:
            sensor.contact, sensor.touched_s = contact, self._clock_s()

    def _is_recent(self, heard_s: float) -> bool:
        return self._clock_s() - heard_s <= FRESH_S

    def _is_alive(self, sensor: _Sensor) -> bool:
        """Whether the sensor runs and its health is fresh;
        its state is unknown if the roster was full when it came.
        """
        return sensor.state in (*ALIVE, "") and self._is_recent(sensor.heard_s)

    def _rank(self, sensor: _Sensor) -> int:
        return 2 if self._is_alive(sensor) else int(sensor.has_health)


class MetricsServer(ThreadingHTTPServer):
    """Serves a registry in its own thread, plus a thread for each of `CONNECTIONS_MAX` connections.

    Raises OSError.
    """

    request_queue_size = CONNECTIONS_MAX

    def __init__(self, host: str, port: int, registry: CollectorRegistry) -> None:
        handler = MetricsHandler.factory(registry)
        # A connection that says nothing would keep its thread.
        handler.timeout = _SPEAK_S
        # HTTPServer would query a name server for the host's own name when it binds,
        # so skip its constructor.
        socketserver.TCPServer.__init__(self, (host, port), handler, bind_and_activate=False)
        # The constructor has made one that accepts any number of connections.
        self.socket.close()
        self.socket = ListeningSocket(host, port, Connections(CONNECTIONS_MAX).admit)
        self.server_address = self.socket.getsockname()
        self.server_port: int = self.server_address[1]
        self.server_activate()
        self._thread = threading.Thread(target=self.serve_forever, args=(_POLL_S,), name="metrics")
        self._thread.start()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that disconnected; let any other error end the thread."""
        if not isinstance(error := sys.exception(), OSError) and error is not None:
            raise error

    def stop(self) -> None:
        self.shutdown()
        self.server_close()
        self._thread.join()


def _state_families(sensors: list[tuple[str, _Sensor]], fresh: Collection[str]) -> Iterator[Metric]:
    """Yield whether each sensor is up, which those in `fresh` are, and its state."""
    up = GaugeMetricFamily(
        "tacshade_up",
        "1 while the daemon is running and publishing its health; absent once it has stopped",
        labels=["sensor"],
    )
    state = GaugeMetricFamily(
        "tacshade_state", "1 for the current state", labels=["sensor", "state"]
    )
    for name, sensor in sensors:
        # A sensor that never published its health is a replay;
        # one that stopped did so on purpose.
        if sensor.has_health and sensor.state != "stopped":
            up.add_metric([name], float(name in fresh))
        for one in STATES if sensor.state else ():
            state.add_metric([name, one], float(sensor.state == one))
    yield from (up, state)


def _contact_families(touches: list[tuple[str, Contact | None, int]]) -> Iterator[Metric]:
    """Yield what touches the sensors, by name: their latest `contact`, if it is of now, and the
    number of contacts so far. What is unknown is absent.
    """
    touching = GaugeMetricFamily(
        "tacshade_contact",
        "1 while something touches, also if its depth is unknown; absent while this is unknown",
        labels=["sensor"],
    )
    depth = GaugeMetricFamily(
        "tacshade_contact_depth_meters", "Greatest depth of the latest frame", labels=["sensor"]
    )
    begun = CounterMetricFamily(
        "tacshade_contacts", "Contacts that have begun since the bridge started", labels=["sensor"]
    )
    for name, latest, contacts in touches:
        begun.add_metric([name], contacts)
        if latest is None or latest.contact is None:
            continue
        touching.add_metric([name], float(bool(latest.contact or latest.touched)))
        if latest.depth_max_mm is not None:
            depth.add_metric([name], latest.depth_max_mm * _M_PER_MM)
    yield from (touching, depth, begun)


Samples = dict[tuple[str, ...], float]
"""Values by the values of a family's labels after the first, the sensor."""


def _percentiles(name: tuple[str, ...], taken_ms: Any) -> Samples:
    found = {"50": taken_ms.p50, "99": taken_ms.p99} if taken_ms is not None else {}
    return {(*name, percentile): ms * _S_PER_MS for percentile, ms in found.items()}


def _stages(health: Health) -> Samples:
    every = [_percentiles((stage,), taken_ms) for stage, taken_ms in health.stages_ms.items()]
    return {labels: seconds for one in every for labels, seconds in one.items()}


def _reasons(health: Health) -> Samples:
    codes = {"invalid": health.invalid_reason_code, "degraded": health.degraded_reason_code}
    return {(about, code): 1.0 for about, code in codes.items() if code}


def _counts(counted: Mapping[str, float], but: tuple[str, ...] = ()) -> Samples:
    return {(what,): count for what, count in counted.items() if what not in but}


_Family = type[CounterMetricFamily] | type[GaugeMetricFamily]
_GAUGE, _COUNTER = GaugeMetricFamily, CounterMetricFamily
_NO_OUTCOMES: Final = ("waiting", "pre_roll")
_OF_LATEST_FRAMES: Final = ("latency_seconds", "stage_seconds", "reason")
# `captured` is left out of the frames' outcomes, as it is their sum;
# `pending` may fall, so it is a gauge.
_OF_HEALTH: Final[
    tuple[tuple[_Family, str, str, tuple[str, ...], Callable[[Health], Samples]], ...]
] = (
    (_GAUGE, "uptime_seconds", "Time since the daemon started", (), lambda h: {(): h.uptime_s}),
    (
        _GAUGE,
        "capture_fps",
        "Frames per second that the camera delivered",
        (),
        lambda h: {(): h.capture_fps},
    ),
    (
        _GAUGE,
        "delivered_fps",
        "Frames per second that ended as they should",
        (),
        lambda h: {(): h.delivered_fps},
    ),
    (
        _GAUGE,
        "published_fps",
        "Frames per second that were published",
        (),
        lambda h: {(): h.published_fps},
    ),
    (
        _COUNTER,
        "frames",
        "Captured frames",
        ("outcome",),
        lambda h: _counts(h.frames, ("captured", "pending")),
    ),
    (
        _COUNTER,
        "touched_frames",
        "Frames in which something touched, but its depth was unknown",
        (),
        lambda h: {(): h.touched_frames},
    ),
    (
        _GAUGE,
        "frames_pending",
        "Frames in progress",
        (),
        lambda h: {(): h.frames.get("pending", 0)},
    ),
    (
        _COUNTER,
        "source_dropped",
        "Frames that never reached the daemon",
        (),
        lambda h: {(): h.source_dropped},
    ),
    (
        _GAUGE,
        "latency_seconds",
        "From time stamp to broker",
        ("percentile",),
        lambda h: _percentiles((), h.latency_ms),
    ),
    (
        _GAUGE,
        "stage_seconds",
        "Time that a stage takes, latest 512 frames",
        ("stage", "percentile"),
        _stages,
    ),
    (
        _GAUGE,
        "reason",
        "1 for why the latest frame is invalid or degraded",
        ("about", "reason_code"),
        _reasons,
    ),
    (_COUNTER, "mqtt", "Messages to the broker, by outcome", ("what",), lambda h: _counts(h.mqtt)),
    (
        _COUNTER,
        "recorder_frames",
        "Frames for recordings",
        ("what",),
        lambda h: _counts(h.recorder, _NO_OUTCOMES),
    ),
)
