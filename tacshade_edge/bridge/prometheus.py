"""Hands' own counters and rates as Prometheus metrics: of what they tell of themselves, nothing is computed for it."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import msgspec
from prometheus_client import Metric
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from tacshade_edge.quoting import quoted

_log = logging.getLogger(__name__)

FRESH_S: Final = 5.0
"""`health` comes once a second; what is older is no hand's present."""

HANDS_MAX: Final = 256
_TOPIC: Final = re.compile(r"tacshade/([A-Za-z0-9_-]{1,64})/(state|health)")
_ALIVE: Final = ("online", "degraded")
_STATES: Final = (*_ALIVE, "stopped", "offline")
_S_PER_MS: Final = 0.001


class _Percentiles(msgspec.Struct, frozen=True):
    p50: float
    p99: float


class _Health(msgspec.Struct, frozen=True):
    """What is told of ``health``; the rest of it is for people."""

    uptime_s: float
    frames: dict[str, int]
    source_dropped: int
    capture_fps: float
    delivered_fps: float
    published_fps: float
    latency_ms: _Percentiles | None
    stages_ms: dict[str, _Percentiles]
    mqtt: dict[str, int]
    recorder: dict[str, int]
    invalid_reason_code: str = ""
    degraded_reason_code: str = ""


@dataclass(slots=True)
class _Hand:
    state: str = ""
    health: _Health | None = None
    heard_s: float = 0.0


class Hands:
    """What hands said last; a collector of a `prometheus_client.CollectorRegistry`.

    Parameters
    ----------
    sensors : sequence of str
        Hands to tell of; empty is all that come.
    clock_s : callable
        Tells the age of what was heard.
    """

    def __init__(self, sensors: list[str], clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self.topics = {f"tacshade/{sensor_id}/{name}" for sensor_id in sensors or ["+"] for name in ("state", "health")}
        self._lock = threading.Lock()
        self._hands: dict[str, _Hand] = {}

    def hear(self, topic: str, payload: bytes, retained: bool) -> None:
        """A message of the broker's. A retained `health` is of another time, and says nothing."""
        if not (found := _TOPIC.fullmatch(topic)) or (retained and found[2] == "health"):
            return
        try:
            health = msgspec.json.decode(payload, type=_Health) if found[2] == "health" else None
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            _log.warning("%s: %s, expected what docs/mqtt.md says", topic, error)
            return
        with self._lock:
            if found[1] not in self._hands and len(self._hands) >= HANDS_MAX:
                _log.warning("%s is one hand more than the %d that are told of", quoted(found[1]), HANDS_MAX)
                return
            hand = self._hands.setdefault(found[1], _Hand())
            if health is None:
                hand.state = payload.decode(errors="replace")
            else:
                hand.health, hand.heard_s = health, self._clock_s()

    def collect(self) -> Iterator[Metric]:
        """All metrics of this moment; of a hand that is silent or gone only that it is."""
        now_s = self._clock_s()
        with self._lock:
            states = {sensor_id: hand.state for sensor_id, hand in sorted(self._hands.items())}
            fresh = {
                sensor_id: hand.health
                for sensor_id, hand in sorted(self._hands.items())
                if hand.health and hand.state in _ALIVE and now_s - hand.heard_s <= FRESH_S
            }
        up = GaugeMetricFamily("tacshade_up", "1 while the daemon lives and tells its health", labels=["sensor"])
        state = GaugeMetricFamily("tacshade_state", "1 for the present state", labels=["sensor", "state"])
        for sensor_id, said in states.items():
            up.add_metric([sensor_id], float(sensor_id in fresh))
            for name in _STATES:
                state.add_metric([sensor_id, name], float(said == name))
        yield from (up, state)
        yield from _of_health(fresh)


def _of_health(fresh: dict[str, _Health]) -> Iterator[Metric]:
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

    yield gauge("tacshade_uptime_seconds", "Since the daemon's start", "uptime_s")
    yield gauge("tacshade_capture_fps", "Frames per second that arrived", "capture_fps")
    yield gauge("tacshade_delivered_fps", "Frames per second that ended as they should", "delivered_fps")
    yield gauge("tacshade_published_fps", "Frames per second that were published", "published_fps")
    # Not `captured`, their sum; `pending` is no outcome yet, and falls again.
    family = CounterMetricFamily(
        "tacshade_frames", "Captured frames, by what became of them", labels=["sensor", "outcome"]
    )
    waiting = GaugeMetricFamily("tacshade_frames_pending", "Frames on their way", labels=["sensor"])
    lost = CounterMetricFamily("tacshade_source_dropped", "Frames that never reached the daemon", labels=["sensor"])
    latency = GaugeMetricFamily(
        "tacshade_latency_seconds",
        "From a frame's time stamp until offered, latest 512",
        labels=["sensor", "percentile"],
    )
    stages = GaugeMetricFamily(
        "tacshade_stage_seconds", "Time of a stage, latest 512 frames", labels=["sensor", "stage", "percentile"]
    )
    reasons = GaugeMetricFamily(
        "tacshade_reason",
        "1 for why the latest frame is invalid or degraded",
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
    yield counters("tacshade_mqtt", "What became of messages to the broker", "what", "mqtt")
    yield counters("tacshade_recorder_frames", "Frames of recordings", "what", "recorder", but=("waiting", "before"))
