"""A sensor's state and health as ROS's diagnostics."""

from __future__ import annotations

from typing import Final, Literal

from tacshade_edge.bridge.ros_messages import ERROR, OK, STALE, WARN, Diagnosis, Level
from tacshade_edge.wire.health_topics import Health
from tacshade_edge.wire.topics import State

_LEVELS: Final[dict[State | Literal[""], Level]] = {
    "online": OK,
    "degraded": WARN,
    "offline": ERROR,
    # On purpose, so no error.
    "stopped": STALE,
    "": STALE,
}


def diagnosis(sensor_id: str, state: State | Literal[""], health: Health | None) -> Diagnosis:
    """Judge a sensor by its state, and by the latest frame's reason if its health is known."""
    values, reasons = {} if health is None else _values(health), []
    level = _LEVELS[state]
    if health is not None:
        reasons = [
            code for code in (health.invalid_reason_code, health.degraded_reason_code) if code
        ]
        level = WARN if level == OK and reasons else level
    message = ": ".join((state or "unknown", *reasons[:1]))
    return Diagnosis(level, f"tacshade: {sensor_id}", message, sensor_id, values)


def _values(health: Health) -> dict[str, str]:
    latency = health.latency_ms
    numbers: dict[str, float] = {
        "uptime_s": health.uptime_s,
        "capture_fps": health.capture_fps,
        "delivered_fps": health.delivered_fps,
        "published_fps": health.published_fps,
        **(
            {}
            if latency is None
            else {"latency_p50_ms": latency.p50, "latency_p99_ms": latency.p99}
        ),
        "source_dropped": health.source_dropped,
        "touched_frames": health.touched_frames,
        **{f"frames_{outcome}": count for outcome, count in health.frames.items()},
    }
    codes = {
        "invalid_reason_code": health.invalid_reason_code,
        "degraded_reason_code": health.degraded_reason_code,
    }
    return {name: str(number) for name, number in numbers.items()} | codes
