"""Format the points for people (Markdown) and programs (CSV, JSON)."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from typing import Any

from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.studies import tables
from tacshade_edge.studies.evaluate.report import versions, without_nan
from tacshade_edge.studies.parallel import usable_cores
from tacshade_edge.studies.tradeoff.summary import Estimate, Point

_HEADER = (
    "method", "what", "ME mm", "SD %", "IoU", "depth off %", "p50 ms", "p99 ms", "fps", "idle ms", "MiB", "missed",
    "phantoms", "front",
)  # fmt: skip
_ESTIMATES = ("me_mm", "sd_pct", "iou", "depth_off_pct", "p50_ms", "p99_ms")


def table(points: Sequence[Point]) -> str:
    """Markdown tables of each setting's accuracy and cost, then its stages."""
    return f"{_settings(points)}\n\nStages of a frame in contact, p50 / p99 ms\n\n{_stages(points)}"


def _settings(points: Sequence[Point]) -> str:
    lines = [
        [
            *_name(p),
            _with_interval(p.me_mm, ".3f"),
            _with_interval(p.sd_pct, ".1f"),
            _number(p.iou.value, ".2f"),
            _with_interval(p.depth_off_pct, ".0f"),
            _with_interval(p.p50_ms, ".2f"),
            _number(p.p99_ms.value, ".2f"),
            _number(p.fps, ".0f"),
            _number(p.idle_p50_ms, ".2f"),
            f"{p.peak_mib:.1f}",
            f"{p.missed}/{p.presses}",
            f"{p.phantoms}/{p.untouched}",
            "yes" if p.front else "",
        ]
        for p in points
    ]
    return tables.markdown(_HEADER, lines)


def _stages(points: Sequence[Point]) -> str:
    lines = []
    for point in points:
        known = {name: f"{p50:.2f} / {p99:.2f}" for name, p50, p99 in point.stages_ms}
        lines.append([*_name(point), *(known.get(stage, "") for stage in STAGES)])
    return tables.markdown(["method", "what", *STAGES], lines)


def _name(point: Point) -> list[str]:
    return [point.setting.profile.name, point.setting.varied or "**as shipped**"]


def _number(value: float, spec: str) -> str:
    return "" if math.isnan(value) else format(value, spec)


def _with_interval(estimate: Estimate, spec: str) -> str:
    if math.isnan(estimate.low):
        return _number(estimate.value, spec)
    return f"{estimate.value:{spec}} ({estimate.low:{spec}} to {estimate.high:{spec}})"


def record(point: Point) -> dict[str, Any]:
    """A point as one flat record: the setting, its figures, and the ends of each interval."""
    line: dict[str, Any] = {
        "setting": str(point.setting),
        "profile": point.setting.profile.name,
        "shipped": point.setting.shipped,
        **point.setting.fields,
        "whole_disc": point.setting.whole_disc,
        "front": point.front,
        "presses": point.presses,
        "missed": point.missed,
        "untouched": point.untouched,
        "phantoms": point.phantoms,
    }
    for name in _ESTIMATES:
        estimate: Estimate = getattr(point, name)
        line |= {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    line |= {"fps": point.fps, "timed": point.timed, "idle_p50_ms": point.idle_p50_ms, "peak_mib": point.peak_mib}
    known = {name: (p50, p99) for name, p50, p99 in point.stages_ms}
    for stage in STAGES:
        p50, p99 = known.get(stage, (math.nan, math.nan))
        line |= {f"{stage}_p50_ms": p50, f"{stage}_p99_ms": p99}
    return line


def csv_text(points: Sequence[Point]) -> str:
    """CSV with one line for each setting; NaN is empty."""
    records = [record(p) for p in points]
    return tables.csv_lines(list(records[0]), [list(r.values()) for r in records])


def document(points: Sequence[Point], data: Mapping[str, Any], busy: float) -> dict[str, Any]:
    """All points for JSON, with their data, machine, versions and how busy the machine was."""
    machine = {"machine": platform.machine(), "system": platform.platform(), "cores": usable_cores(), "busy": busy}
    found: dict[str, Any] = without_nan(
        {"data": dict(data), "board": machine, "versions": versions(), "points": [record(p) for p in points]}
    )
    return found
