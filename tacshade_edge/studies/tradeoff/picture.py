"""Error against time; matplotlib is imported only here, and only to draw."""

from __future__ import annotations

import importlib.util
import io
import math
from collections.abc import Sequence
from typing import Any

from tacshade_edge.studies.tradeoff.summary import Estimate, Point

INSTALL = "matplotlib draws it: pip install 'tacshade-edge[studies]'"
_COLOURS = ("#8a5fb0", "#e4572e", "#4a9c5d", "#3d6fb4")


def can_draw() -> bool:
    """Whether matplotlib is installed (without importing it)."""
    return importlib.util.find_spec("matplotlib") is not None


def draw(points: Sequence[Point], budget_ms: float | None) -> bytes:
    """PNG: ME against p50, both logarithmic, with their intervals; the front, the shipped profiles, the budget."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure = Figure(figsize=(8.4, 5.2), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e6e6e6", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xscale("log")
    axes.set_yscale("log")
    known = [p for p in points if math.isfinite(p.me_mm.value) and math.isfinite(p.p50_ms.value)]
    for k, name in enumerate(dict.fromkeys(p.setting.profile.name for p in points)):
        for point in (p for p in known if p.setting.profile.name == name):
            _mark(axes, point, _COLOURS[k % len(_COLOURS)])
        axes.plot([], [], "o", color=_COLOURS[k % len(_COLOURS)], label=f"{name} and what differs from it")
    front = sorted((p.p50_ms.value, p.me_mm.value) for p in known if p.front)
    if front:
        axes.plot(*zip(*front, strict=True), color="#888888", linewidth=1.2, zorder=1, label="Pareto front")
    axes.plot([], [], "D", color="#444444", markersize=9, label="shipped")
    if budget_ms is not None:
        axes.axvline(budget_ms, color="#888888", linewidth=1, linestyle=":", label=f"budget of {budget_ms:g} ms")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="ms for a frame in contact, p50, one thread", ylabel="ME in mm, mean over presses")
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


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
    if shipped or (point.front and point.setting.varied):
        axes.annotate(
            point.setting.profile.name if shipped else point.setting.varied,
            (point.p50_ms.value, point.me_mm.value),
            xytext=(8, 6) if shipped else (5, -11),
            textcoords="offset points",
            fontsize=10 if shipped else 7.5,
            fontweight="bold" if shipped else "normal",
            color=colour,
        )


def _ends(estimate: Estimate) -> list[list[float]] | None:
    if math.isnan(estimate.low):
        return None
    return [[max(estimate.value - estimate.low, 0)], [max(estimate.high - estimate.value, 0)]]
