"""The plot of `bench`; only drawing it imports matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Protocol


class Measured(Protocol):
    """A run of `bench`."""

    @property
    def scene(self) -> str: ...
    @property
    def labelled(self) -> bool: ...
    @property
    def speed_mm_s(self) -> float: ...
    @property
    def delay_ms(self) -> float: ...
    @property
    def error(self) -> Mapping[str, float]: ...


_COLOURS = ("#3d6fb4", "#4a9c5d", "#e4572e", "#8a5fb0")


def draw(runs: Sequence[Measured]) -> bytes:
    """Draw a PNG: a row per scene, each quantity's error against added latency, a line per speed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(run.scene for run in runs))
    columns = max(len(run.error) for run in runs)
    figure = Figure(figsize=(4.2 * columns, 3.2 * len(scenes)), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(scenes), columns, squeeze=False)
    for row, name in zip(axes, scenes, strict=True):
        some = [run for run in runs if run.scene == name]
        for each, quantity in zip(row, some[0].error, strict=True):
            speeds = list(dict.fromkeys(run.speed_mm_s for run in some))
            for speed, labelled in dict.fromkeys((run.speed_mm_s, run.labelled) for run in some):
                key = (speed, labelled)
                line = [(run.delay_ms, run.error[quantity]) for run in some if (run.speed_mm_s, run.labelled) == key]
                each.plot(
                    *zip(*line, strict=True),
                    color=_COLOURS[speeds.index(speed) % len(_COLOURS)],
                    marker="o",
                    linestyle="-" if labelled else ":",
                    label=f"{speed:g} mm/s{'' if labelled else ', without labels'}",
                )
            each.spines[["top", "right"]].set_visible(False)
            each.grid(color="#e6e6e6", linewidth=0.8)
            each.set_axisbelow(True)
            words, _, unit = quantity.rpartition("_")
            unit = {"deg": "°"}.get(unit, unit)
            each.set(title=f"follow_{name}: {words.replace('_', ' ')}", xlabel="added latency in ms")
            each.set_ylabel(f"root mean square error in {unit}")
            each.set_ylim(0, 1.1 * max(run.error[quantity] for run in some))
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
