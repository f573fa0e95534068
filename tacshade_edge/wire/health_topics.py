"""``health`` of a sensor and of a hand: the types of what both report once a second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from .bounds import Code, Count, Counts, Key, Rate


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Percentiles of times in ms."""

    p50: Rate
    p99: Rate


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """``health`` of a sensor: the counts and measures that every sensor has;
    the rest is for people.
    """

    uptime_s: Rate
    frames: Counts
    source_dropped: Count
    capture_fps: Rate
    delivered_fps: Rate
    published_fps: Rate
    latency_ms: Percentiles | None
    stages_ms: Annotated[dict[Key, Percentiles], Meta(max_length=64)]
    mqtt: Counts
    recorder: Counts
    invalid_reason_code: Code = ""
    degraded_reason_code: Code = ""
    wall_ns: Count = 0
    touched_frames: Count = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class HandHealth:
    """``health`` of a hand: how many messages of each finger it received,
    and how many were damaged.
    """

    wall_ns: Count = 0
    uptime_s: Rate
    heard: Counts
    undecodable: Count
    mqtt: Counts
