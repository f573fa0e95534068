"""Points of a study of speed against accuracy, as a test wants them."""

from __future__ import annotations

from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.studies.tradeoff.measure import Estimate, Point, Setting


def around(value: float) -> Estimate:
    return Estimate(value, 0.9 * value, 1.1 * value)


def point(profile: Profile | str, me_mm: float, p50_ms: float, *, front: bool = False) -> Point:
    """A setting with these figures; its p99 is twice its p50."""
    return Point(
        setting=Setting(PROFILES[profile] if isinstance(profile, str) else profile),
        presses=30, missed=1, untouched=20, phantoms=2, me_mm=around(me_mm), sd_pct=around(90), iou=around(0.8),
        depth_off_pct=around(8), p50_ms=around(p50_ms), p99_ms=around(2 * p50_ms), fps=1000 / p50_ms, timed=100,
        idle_p50_ms=0.3, stages_ms=(("check", 0.1, 0.2), ("gate", 0.2, 0.4)), peak_mib=12.34, front=front,
    )  # fmt: skip
