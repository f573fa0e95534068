"""Plot error against time; only drawing imports matplotlib, and only here."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

from tacshade_edge.studies.tradeoff.summary import Estimate, Point

NEAR = 1.5
"""The second panel's limits as multiples of the slowest and the least accurate setting on the front."""

_COLOURS = ("#8a5fb0", "#e4572e", "#4a9c5d", "#3d6fb4")


def draw(points: Sequence[Point], budget_ms: float | None) -> bytes:
    """Plot ME against p50 as a PNG, with intervals, front, shipped profiles and budget: all, and around the front."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure = Figure(figsize=(13, 5.6), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    known = [p for p in points if math.isfinite(p.me_mm.value) and math.isfinite(p.p50_ms.value)]
    slowest_ms = max((p.p50_ms.value for p in known if p.front), default=math.inf)
    worst_mm = max((p.me_mm.value for p in known if p.front), default=math.inf)
    near = [p for p in known if p.p50_ms.value < NEAR * slowest_ms and p.me_mm.value < NEAR * worst_mm]
    colours = dict(zip(dict.fromkeys(p.setting.profile.name for p in points), cycle(_COLOURS), strict=False))
    everything, around = figure.subplots(1, 2)
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
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def _scatter(
    axes: Any, points: Sequence[Point], colours: Mapping[str, str], budget_ms: float | None, *, detailed: bool
) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e6e6e6", linewidth=0.8)
    axes.set_axisbelow(True)
    for name, colour in colours.items():
        mine = sorted((p for p in points if p.setting.profile.name == name), key=lambda p: p.p50_ms.value)
        for point in mine:
            _mark(axes, point, colour)
        if detailed:
            # Many points lie side by side, so their names go one below another.
            for rank, point in enumerate(p for p in mine if p.front and p.setting.varied):
                _name(axes, point, point.setting.varied, colour, (6, -20 - 10 * rank))
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
    axes.errorbar(
        point.p50_ms.value,
        point.me_mm.value,
        xerr=_ends(point.p50_ms),
        yerr=_ends(point.me_mm),
        fmt="D" if shipped else "o",
        markersize=10 if shipped else 5,
        markeredgecolor="white" if shipped else colour,
        color=colour,
        alpha=1.0 if shipped else 0.65,
        linewidth=0.8,
        zorder=3 if shipped else 2,
    )
    if shipped:
        _name(axes, point, point.setting.profile.name, colour, (8, 6))


def _name(axes: Any, point: Point, text: str, colour: str, offset: tuple[int, int]) -> None:
    large = point.setting.shipped
    axes.annotate(
        text,
        (point.p50_ms.value, point.me_mm.value),
        xytext=offset,
        textcoords="offset points",
        fontsize=10 if large else 7.5,
        fontweight="bold" if large else "normal",
        color=colour,
    )


def _ends(estimate: Estimate) -> list[list[float]] | None:
    if math.isnan(estimate.low):
        return None
    return [[max(estimate.value - estimate.low, 0)], [max(estimate.high - estimate.value, 0)]]
