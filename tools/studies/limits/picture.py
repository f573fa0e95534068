"""The four plots of the study of limits; only drawing them imports matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from tools.studies.limits.rows import DepthRow, DisturbedRow, FineRow
from tools.studies.limits.summary import (
    DETECTED,
    FINE,
    WRONG,
    depth_errors,
    detected,
    finest,
    profiles_of,
    silently_wrong,
)
from tools.studies.limits.work import Limits

_COLOURS = ("#3d6fb4", "#e4572e", "#4a9c5d", "#8a5fb0")
_STYLES, _MARKERS = ("-", "--", ":"), ("o", "s", "^")


def draw(found: Limits) -> dict[str, bytes]:
    """Draw the plots; return a PNG by file name."""
    return {
        "limits_detection.png": _detection(found.faint),
        "limits_depth.png": _depth(found.deep),
        "limits_resolution.png": _resolution(found.fine),
        "limits_disturbed.png": _disturbed(found.disturbed),
    }


def _figure(columns: int, width: float = 5.4, height: float = 4.0) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * columns, height), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
        each.grid(color="#e6e6e6", linewidth=0.8)
        each.set_axisbelow(True)
    return figure, axes


def _png(figure: Any) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def _detection(rows: Sequence[DepthRow]) -> bytes:
    profiles = profiles_of(rows)
    figure, axes = _figure(len(profiles))
    for each, profile in zip(axes, profiles, strict=True):
        for k, radius in enumerate(sorted({r.radius_mm for r in rows})):
            depth, part = zip(*detected(rows, profile, radius), strict=True)
            each.plot(
                depth,
                100 * np.array(part),
                color=_COLOURS[k],
                marker=_MARKERS[k],
                label=f"ball of {radius:g} mm radius",
            )
        each.axhline(100 * DETECTED, color="#888888", linewidth=1, linestyle=":")
        each.set(title=profile, xlabel="depth (greatest h) in mm", ylabel="presses found in %", xlim=(0, 1.0))
        each.set_ylim(-3, 103)
        each.text(0.01, 100 * DETECTED - 1, f"{100 * DETECTED:g} %", va="top", fontsize=8, color="#666666")
    axes[0].legend(loc="lower right", frameon=False)
    return _png(figure)


def _depth(rows: Sequence[DepthRow]) -> bytes:
    figure, (error, told) = _figure(2)
    for k, profile in enumerate(profiles_of(rows)):
        for j, name in enumerate(dict.fromkeys(r.object for r in rows)):
            depth, mean, high, saturated = (np.array(v) for v in zip(*depth_errors(rows, profile, name), strict=True))
            style = {"color": _COLOURS[k], "linestyle": _STYLES[j]}
            error.plot(depth, mean, label=f"{profile}, {name}", **style)
            if j == 0:
                error.fill_between(
                    depth, mean, high, color=_COLOURS[k], alpha=0.15, linewidth=0, label=f"{profile}, {name}: to 90 %"
                )
            told.plot(depth, 100 * saturated, label=f"{profile}, {name}", **style)
    error.set(xlabel="depth (greatest h) in mm", ylabel="error of the depth in mm, mean")
    told.set(xlabel="depth (greatest h) in mm", ylabel='frames told "saturated" in %', ylim=(-3, 103))
    error.set_ylim(bottom=0)
    error.legend(frameon=False)
    return _png(figure)


def _resolution(rows: Sequence[FineRow]) -> bytes:
    figure, axes = _figure(len(FINE), 4.2)
    pitches = sorted({r.pitch_mm for r in rows})
    for each, (question, (shape, _)) in zip(axes, FINE.items(), strict=True):
        tried = sorted({r.size_mm for r in rows if r.shape == shape})
        none = tried[-1] * 1.08
        for k, profile in enumerate(profiles_of(rows)):
            sizes = np.array([finest(rows, profile, pitch, question) for pitch in pitches])
            shown = np.where(np.isfinite(sizes), sizes, none)
            each.plot(pitches, shown, color=_COLOURS[k], marker=_MARKERS[k], linestyle=_STYLES[k], label=profile)
        each.plot(pitches, pitches, color="#888888", linewidth=1, linestyle=":", label="one pitch")
        each.axhspan(tried[-1] * 1.04, tried[-1] * 1.22, color="#f0f0f0", linewidth=0)
        each.text(pitches[0], tried[-1] * 1.2, "none of those tried", va="top", fontsize=8, color="#666666")
        each.set(title=question, xlabel="marker pitch in mm", ylim=(0, tried[-1] * 1.22))
        each.set_ylabel(f"smallest {'gap' if shape == 'bars' else 'width'} in mm")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return _png(figure)


def _disturbed(rows: Sequence[DisturbedRow]) -> bytes:
    figure, (axes,) = _figure(1, 7.2, 4.2)
    kinds, profiles = list(dict.fromkeys(r.disturbance for r in rows)), profiles_of(rows)
    wrong = False
    for k, profile in enumerate(profiles):
        for j, kind in enumerate(kinds):
            some = [r for r in rows if r.profile == profile and r.disturbance == kind]
            at = j + 0.36 * ((k + 0.5) / len(profiles) - 0.5) * 2
            spread = at + np.linspace(-0.1, 0.1, len(some))
            bad = {id(r) for r in silently_wrong(some)}
            for x, row in zip(spread, some, strict=True):
                wrong |= id(row) in bad
                axes.plot(
                    100 * min(row.off, 1.0), x, "x" if id(row) in bad else ".", color=_COLOURS[k], markersize=6,
                    alpha=1 if id(row) in bad else 0.6,
                )  # fmt: skip
        axes.plot([], [], "o", color=_COLOURS[k], label=profile)
    if wrong:
        axes.plot([], [], "x", color="#444444", label="wrong without a word")
    axes.axvline(100 * WRONG, color="#888888", linewidth=1, linestyle=":")
    axes.set_yticks(range(len(kinds)), kinds)
    axes.invert_yaxis()
    axes.set(xlabel="change of a 2 mm contact's depth in % of the undisturbed frame's", xlim=(-1, None))
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return _png(figure)
