"""Format the points for people (Markdown, a plot), programs (CSV, JSON), settings files and the list of boards."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from typing import Any

from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.studies import tables
from tacshade_edge.studies.evaluate.report import versions
from tacshade_edge.studies.parallel import usable_cores
from tacshade_edge.studies.tradeoff.measure import Estimate, Point

_ESTIMATES = ("me_mm", "sd_pct", "iou", "depth_off_pct", "p50_ms", "p99_ms")


def table(points: Sequence[Point]) -> str:
    """Markdown tables of each setting's accuracy and cost, then its stages."""
    return f"{_settings(points)}\n\nStages of a frame in contact, p50 / p99 ms\n\n{_stages(points)}"


_COLUMNS: dict[str, Callable[[Point], str]] = {
    "ME mm": lambda p: _with_interval(p.me_mm, ".3f"),
    "SD %": lambda p: _with_interval(p.sd_pct, ".1f"),
    "IoU": lambda p: tables.number(p.iou.value, ".2f"),
    "depth off %": lambda p: _with_interval(p.depth_off_pct, ".0f"),
    "p50 ms": lambda p: _with_interval(p.p50_ms, ".2f"),
    "p99 ms": lambda p: tables.number(p.p99_ms.value, ".2f"),
    "fps": lambda p: tables.number(p.fps, ".0f"),
    "idle ms": lambda p: tables.number(p.idle_p50_ms, ".2f"),
    "MiB": lambda p: f"{p.peak_mib:.1f}",
    "missed": lambda p: f"{p.missed}/{p.presses}",
    "phantoms": lambda p: f"{p.phantoms}/{p.untouched}",
    "front": lambda p: "yes" if p.front else "",
}


def _settings(points: Sequence[Point]) -> str:
    lines = [[*_name(point), *(cell(point) for cell in _COLUMNS.values())] for point in points]
    return tables.markdown(["method", "what", *_COLUMNS], lines)


def _stages(points: Sequence[Point]) -> str:
    lines = []
    for point in points:
        known = {name: f"{p50:.2f} / {p99:.2f}" for name, p50, p99 in point.stages_ms}
        lines.append([*_name(point), *(known.get(stage, "") for stage in STAGES)])
    return tables.markdown(["method", "what", *STAGES], lines)


def _name(point: Point) -> list[str]:
    return [point.setting.profile.name, point.setting.varied or "**as shipped**"]


def _with_interval(estimate: Estimate, spec: str) -> str:
    if math.isnan(estimate.low):
        return tables.number(estimate.value, spec)
    return f"{estimate.value:{spec}} ({estimate.low:{spec}} to {estimate.high:{spec}})"


def record(point: Point) -> dict[str, Any]:
    """A point as one flat record: the setting, its figures, and the ends of each interval."""
    line: dict[str, Any] = {
        "setting": str(point.setting),
        "profile": point.setting.profile.name,
        "shipped": point.setting.shipped,
        **point.setting.fields,
        **{name: getattr(point, name) for name in ("front", "presses", "missed", "untouched", "phantoms")},
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
    found: dict[str, Any] = tables.without_nan(
        {"data": dict(data), "board": machine, "versions": versions(), "points": [record(p) for p in points]}
    )
    return found


PROFILES = ("fast", "balanced", "accurate")
HEADER = ("board", "processor", "system", "version", *PROFILES, "untouched", "MiB", "busy")


def board_block(facts: Mapping[str, str], points: Sequence[Point], busy: float) -> str:
    """The Markdown block of a board: its row of docs/reference/boards.md, and its facts (`doctor.board_facts`).

    `points` are those of the shipped profiles, and `busy` is elapsed time over this command's processor time.
    """
    beside = [f"- {name}: {text}" for name, text in facts.items()]
    rule = "|".join(["---"] * len(HEADER))
    table = [f"| {' | '.join(HEADER)} |", f"|{rule}|", board_row(facts, points, busy)]
    return "\n".join([*table, "", *beside, ""])


def board_row(facts: Mapping[str, str], points: Sequence[Point], busy: float) -> str:
    """The board as a row under `HEADER`."""
    found = {point.setting.profile.name: point for point in points if point.setting.shipped}
    times = [_times(found.get(name)) for name in PROFILES]
    cores = facts["cores"].partition(",")[0]
    processor = f"{facts.get('processor', 'unknown')}, {cores} cores"
    some = [found[name] for name in PROFILES if name in found]
    quiet = [point.idle_p50_ms for point in some if not math.isnan(point.idle_p50_ms)]
    cells = [facts["board"], processor, facts.get("system", "unknown"), facts["tacshade-edge"], *times]
    cells.append(f"{min(quiet):.2f} to {max(quiet):.2f}" if quiet else "")
    cells.append(f"{max(point.peak_mib for point in some):.0f}" if some else "")
    return f"| {' | '.join([*cells, f'{busy:.1f}'])} |"


def _times(point: Point | None) -> str:
    return "" if point is None or not point.timed else f"{point.p50_ms.value:.2f} / {point.p99_ms.value:.2f}"


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


NEAR = 1.5
"""The second panel's limits as multiples of the slowest and the least accurate setting on the front."""

_COLOURS = ("#8a5fb0", "#e4572e", "#4a9c5d", "#3d6fb4")


def draw(points: Sequence[Point], budget_ms: float | None) -> bytes:
    """Plot ME against p50 as a PNG, with intervals, front, shipped profiles and budget: all, and around the front."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure, ((everything, around),) = tables.new_figure(1, 2, 13, 5.6)
    known = [p for p in points if math.isfinite(p.me_mm.value) and math.isfinite(p.p50_ms.value)]
    slowest_ms = max((p.p50_ms.value for p in known if p.front), default=math.inf)
    worst_mm = max((p.me_mm.value for p in known if p.front), default=math.inf)
    near = [p for p in known if p.p50_ms.value < NEAR * slowest_ms and p.me_mm.value < NEAR * worst_mm]
    colours = dict(zip(dict.fromkeys(p.setting.profile.name for p in points), cycle(_COLOURS), strict=False))
    for axes, some in ((everything, known), (around, near)):
        _scatter(axes, some, colours, budget_ms, detailed=axes is around)
    everything.set(xscale="log", yscale="log", title="all settings")
    around.set(title="around the front")
    around.set_xlim(left=0)
    around.set_ylim(bottom=0)
    for axis in (everything.xaxis, everything.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    figure.legend(*everything.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return tables.png(figure)


def _scatter(
    axes: Any, points: Sequence[Point], colours: Mapping[str, str], budget_ms: float | None, *, detailed: bool
) -> None:
    for name, colour in colours.items():
        mine = sorted((p for p in points if p.setting.profile.name == name), key=lambda p: p.p50_ms.value)
        for point in mine:
            _mark(axes, point, colour)
        if detailed:
            # Many points lie side by side, so their names go one below another.
            for rank, point in enumerate(p for p in mine if p.front and p.setting.varied):
                _annotate(axes, point, point.setting.varied, colour, (6, -20 - 10 * rank))
        axes.plot([], [], "o", color=colour, label=f"{name} and what differs from it")
    front = sorted((p.p50_ms.value, p.me_mm.value) for p in points if p.front)
    if front:
        axes.plot(*zip(*front, strict=True), color="#888888", linewidth=1.2, zorder=1, label="Pareto front")
    axes.plot([], [], "D", color="#444444", markersize=9, label="shipped")
    if budget_ms is not None:
        axes.axvline(budget_ms, color="#888888", linewidth=1, linestyle=":", label=f"budget of {budget_ms:g} ms")
    axes.set(xlabel="ms for a frame in contact, p50, one thread", ylabel="ME in mm, mean over presses")


def _mark(axes: Any, point: Point, colour: str) -> None:
    shipped = point.setting.shipped
    style = {"fmt": "o", "markersize": 5, "markeredgecolor": colour, "alpha": 0.65, "zorder": 2}
    if shipped:
        style = {"fmt": "D", "markersize": 10, "markeredgecolor": "white", "alpha": 1.0, "zorder": 3}
        _annotate(axes, point, point.setting.profile.name, colour, (8, 6))
    ends = {"xerr": _ends(point.p50_ms), "yerr": _ends(point.me_mm)}
    axes.errorbar(point.p50_ms.value, point.me_mm.value, **ends, **style, color=colour, linewidth=0.8)


def _annotate(axes: Any, point: Point, text: str, colour: str, offset: tuple[int, int]) -> None:
    style = {"fontsize": 7.5, "color": colour}
    if point.setting.shipped:
        style |= {"fontsize": 10, "fontweight": "bold"}
    at = (point.p50_ms.value, point.me_mm.value)
    axes.annotate(text, at, xytext=offset, textcoords="offset points", **style)


def _ends(estimate: Estimate) -> list[list[float]] | None:
    if math.isnan(estimate.low):
        return None
    return [[max(estimate.value - estimate.low, 0)], [max(estimate.high - estimate.value, 0)]]
