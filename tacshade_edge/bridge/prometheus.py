"""Serves the counters and rates that sensors publish as Prometheus metrics."""

from __future__ import annotations

import re
import socketserver
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.server import ThreadingHTTPServer
from typing import Any, Final, Literal

from prometheus_client import CollectorRegistry, Metric, MetricsHandler
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from tacshade_edge.bridge.roster import SENSORS_MAX, Refusals, Roster
from tacshade_edge.devices.listener import Connections, Listener
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.topics import ALIVE, STATES, Health, State, decode_health, decode_state

FRESH_S: Final = 5.0
"""Age at which a sensor's `health`, published once a second, is out of date."""

CONNECTIONS_MAX: Final = 16
"""Limit on connections, each of which has a thread; further ones are closed at once."""
_SPEAK_S: Final = 5.0
_POLL_S: Final = 0.1
_TOPIC: Final = re.compile(r"tacshade/([A-Za-z0-9_-]{1,64})/(state|health)")
_S_PER_MS: Final = 0.001


@dataclass(slots=True)
class _Sensor:
    state: State | Literal[""] = ""
    health: Health | None = None
    heard_s: float = float("-inf")
    has_health: bool = False


class SensorMetrics:
    """The latest states and counters of some sensors, or all that publish: a collector for a `CollectorRegistry`."""

    def __init__(self, sensors: list[str], clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self.topics = {f"tacshade/{sensor_id}/{name}" for sensor_id in sensors or ["+"] for name in ("state", "health")}
        self._lock = threading.Lock()
        self._sensors: Roster[_Sensor] = Roster(lambda _: _Sensor(), self._rank)
        self._refusals = Refusals(clock_s)

    def hear(self, topic: str, payload: bytes, retained: bool) -> None:
        """Process a message from the broker. A retained `health` may be old: it only shows that the sensor has one."""
        with self._lock:
            if not (found := _TOPIC.fullmatch(topic)):
                self._refusals.add("unknown_topic", topic, "ignoring this topic, which is no sensor's")
                return
            sensor_id, name = found.groups()
            try:
                if name == "state":
                    self._hear_state(sensor_id, payload)
                elif payload:
                    self._hear_health(sensor_id, decode_health(payload), retained=retained)
            except DecodeError as error:
                self._refusals.add("undecodable", sensor_id, str(error))

    def collect(self) -> Iterator[Metric]:
        """Yield all current metrics; of a silent or stopped sensor only whether it is up and its state."""
        with self._lock:
            sensors = list(self._sensors)
            refused = dict(self._refusals.counts)
            fresh = {name: sensor.health for name, sensor in sensors if sensor.health and self._is_alive(sensor)}
        up = GaugeMetricFamily(
            "tacshade_up",
            "1 while the daemon is running and publishing its health; absent once it has stopped",
            labels=["sensor"],
        )
        state = GaugeMetricFamily("tacshade_state", "1 for the current state", labels=["sensor", "state"])
        for name, sensor in sensors:
            # A sensor that never published its health is a replay; one that stopped did so on purpose.
            if sensor.has_health and sensor.state != "stopped":
                up.add_metric([name], float(name in fresh))
            for one in STATES if sensor.state else ():
                state.add_metric([name, one], float(sensor.state == one))
        family = CounterMetricFamily(
            "tacshade_bridge_refused", "Messages that the bridge left out, by reason", labels=["why"]
        )
        for why, count in refused.items():
            family.add_metric([why], count)
        yield from (up, state, family)
        yield from _of_health(fresh)

    def _hear_state(self, sensor_id: str, payload: bytes) -> None:
        if not payload:
            self._sensors.drop(sensor_id)
            return
        state = decode_state(payload)
        if sensor := self._held(sensor_id, 0):
            sensor.state = state

    def _hear_health(self, sensor_id: str, health: Health, *, retained: bool) -> None:
        if sensor := self._held(sensor_id, 1 if retained else 2):
            sensor.has_health = True
            if not retained:
                sensor.health, sensor.heard_s = health, self._clock_s()

    def _held(self, sensor_id: str, rank: int) -> _Sensor | None:
        sensor = self._sensors.of(sensor_id, rank)
        if sensor is None:
            self._refusals.add(
                "no_room", sensor_id, f"ignoring this sensor: {SENSORS_MAX} are already reported, the limit"
            )
        return sensor

    def _is_alive(self, sensor: _Sensor) -> bool:
        """Whether the sensor runs and its health is fresh; its state is unknown if the roster was full when it came."""
        return sensor.state in (*ALIVE, "") and self._clock_s() - sensor.heard_s <= FRESH_S

    def _rank(self, sensor: _Sensor) -> int:
        return 2 if self._is_alive(sensor) else int(sensor.has_health)


class MetricsServer(ThreadingHTTPServer):
    """Serves a registry in its own thread, plus a thread for each of `CONNECTIONS_MAX` connections. Raises OSError."""

    request_queue_size = CONNECTIONS_MAX

    def __init__(self, host: str, port: int, registry: CollectorRegistry) -> None:
        handler = MetricsHandler.factory(registry)
        handler.timeout = _SPEAK_S
        # HTTPServer would query a name server for the host's own name when it binds, so skip its constructor.
        socketserver.TCPServer.__init__(self, (host, port), handler, bind_and_activate=False)
        self.socket.close()
        self.socket = Listener(host, port, Connections(CONNECTIONS_MAX).admit)
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
        """Stop the server, even while clients are connected."""
        self.shutdown()
        self.server_close()
        self._thread.join()


def _of_health(fresh: dict[str, Health]) -> Iterator[Metric]:
    def gauge(name: str, text: str, value: str) -> Metric:
        family = GaugeMetricFamily(name, text, labels=["sensor"])
        for sensor_id, health in fresh.items():
            family.add_metric([sensor_id], getattr(health, value))
        return family

    def counters(name: str, text: str, label: str, value: str, but: tuple[str, ...] = ()) -> Metric:
        family = CounterMetricFamily(name, text, labels=["sensor", label])
        for sensor_id, health in fresh.items():
            for key, count in getattr(health, value).items():
                if key not in but:
                    family.add_metric([sensor_id, key], count)
        return family

    yield gauge("tacshade_uptime_seconds", "Time since the daemon started", "uptime_s")
    yield gauge("tacshade_capture_fps", "Frames per second that the camera delivered", "capture_fps")
    yield gauge("tacshade_delivered_fps", "Frames per second that ended as they should", "delivered_fps")
    yield gauge("tacshade_published_fps", "Frames per second that were published", "published_fps")
    # `captured` is left out, as it is the sum; `pending` is not an outcome and may fall, so it is a gauge.
    family = CounterMetricFamily("tacshade_frames", "Captured frames, by outcome", labels=["sensor", "outcome"])
    waiting = GaugeMetricFamily("tacshade_frames_pending", "Frames in progress", labels=["sensor"])
    lost = CounterMetricFamily("tacshade_source_dropped", "Frames that never reached the daemon", labels=["sensor"])
    latency = GaugeMetricFamily(
        "tacshade_latency_seconds",
        "From a frame's time stamp until its result goes to the broker, latest 512 frames",
        labels=["sensor", "percentile"],
    )
    stages = GaugeMetricFamily(
        "tacshade_stage_seconds", "Time that a stage takes, latest 512 frames", labels=["sensor", "stage", "percentile"]
    )
    reasons = GaugeMetricFamily(
        "tacshade_reason",
        "1 for the reason why the latest frame is invalid or degraded",
        labels=["sensor", "about", "reason_code"],
    )
    for sensor_id, health in fresh.items():
        for outcome, count in health.frames.items():
            if outcome == "pending":
                waiting.add_metric([sensor_id], count)
            elif outcome != "captured":
                family.add_metric([sensor_id, outcome], count)
        lost.add_metric([sensor_id], health.source_dropped)
        for percentile, of in (("50", "p50"), ("99", "p99")):
            if health.latency_ms is not None:
                latency.add_metric([sensor_id, percentile], getattr(health.latency_ms, of) * _S_PER_MS)
            for stage, taken_ms in health.stages_ms.items():
                stages.add_metric([sensor_id, stage, percentile], getattr(taken_ms, of) * _S_PER_MS)
        for about, code in (("invalid", health.invalid_reason_code), ("degraded", health.degraded_reason_code)):
            if code:
                reasons.add_metric([sensor_id, about, code], 1.0)
    yield from (family, waiting, lost, latency, stages, reasons)
    yield counters("tacshade_mqtt", "Messages to the broker, by outcome", "what", "mqtt")
    yield counters(
        "tacshade_recorder_frames", "Frames for recordings, by outcome", "what", "recorder", but=("waiting", "pre_roll")
    )
