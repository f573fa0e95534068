"""Choose the most accurate shipped profile that keeps a budget, as lines of a settings file."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.studies.tradeoff.summary import Point


def best_within(points: Sequence[Point], budget_ms: float) -> Point | None:
    """The point with the least ME among those with a p99 within the budget; None if there is none."""
    return min((p for p in points if p.p99_ms.value <= budget_ms), key=lambda p: p.me_mm.value, default=None)


def settings_block(points: Sequence[Point], budget_ms: float) -> str | None:
    """YAML for a settings file, with the reason in comments; None if no shipped profile keeps the budget."""
    chosen = best_within([p for p in points if p.setting.shipped], budget_ms)
    if chosen is None:
        return None
    lines = [f"# The most accurate within {budget_ms:g} ms for 99 of 100 frames in contact: {_said(chosen)}."]
    other = best_within(points, budget_ms)
    if other is not None and other.me_mm.high < chosen.me_mm.low:
        lines.append(f"# Better, but not a shipped profile: {other.setting} ({_said(other)}).")
    return "\n".join((*lines, f"profile: {chosen.setting.profile.name}"))


def over_budget(points: Sequence[Point], budget_ms: float) -> str:
    """The message that no shipped profile keeps the budget, and which comes closest."""
    shipped = [p for p in points if p.setting.shipped and p.p99_ms.value > budget_ms]
    if not shipped:
        return f"no shipped profile was timed, so none can be chosen for {budget_ms:g} ms"
    least = min(shipped, key=lambda p: p.p99_ms.value)
    return (
        f"no shipped profile stays within {budget_ms:g} ms for a frame in contact; the fastest, "
        f"{least.setting.profile.name}, takes {least.p99_ms.value:.2f} ms (p99) here"
    )


def _said(point: Point) -> str:
    return f"p99 {point.p99_ms.value:.2f} ms, p50 {point.p50_ms.value:.2f} ms, ME {point.me_mm.value:.3f} mm"
