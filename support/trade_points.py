"""Rows of a trade of error against time, as a test wants them."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.lab.studies.tradeoff.judging import Setting
from tacshade_edge.lab.studies.tradeoff.measure import Estimate, Offer, Times


def row(
    profile: str,
    error: float,
    ms: float,
    *,
    outputs: Sequence[str] = ("height",),
    half: bool = False,
    fitted: bool = False,
    front: bool = False,
) -> Offer:
    """All outputs have the same error; p99 is twice `ms`."""
    size = (320, 240) if half else (640, 480)
    errors = dict.fromkeys(outputs, Estimate(error, 0.9 * error, 1.1 * error))
    times = Times(p50_ms=ms, p99_ms=2 * ms, mean_ms=ms, idle_ms=0.3)
    return Offer(
        tuple(outputs),
        Setting(profile, half, fitted),
        *size,
        errors,
        30,
        1,
        20,
        2,
        times,
        12.34,
        front,
    )
