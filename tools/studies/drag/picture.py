"""Error over drag, a panel for each family and a line for each profile; matplotlib is imported to draw only."""

from __future__ import annotations

import io
from collections.abc import Sequence

from tools.studies.drag.summary import family_of, figures
from tools.studies.drag.work import DragRow

_COLOURS = ("#3d6fb4", "#e4572e", "#4a9c5d", "#8a5fb0")


def draw(rows: Sequence[DragRow]) -> bytes:
    """A PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    families = list(dict.fromkeys(family_of(row) for row in rows))
    figure = Figure(figsize=(5.5 * len(families), 7), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    for column, family in zip(figure.subplots(2, len(families), squeeze=False).T, families, strict=True):
        mine = [row for row in rows if family_of(row) == family]
        conditions = list(dict.fromkeys(row.condition for row in mine))
        for colour, profile in zip(_COLOURS, dict.fromkeys(row.profile for row in mine), strict=False):
            made = [figures([r for r in mine if r.profile == profile and r.condition == c]) for c in conditions]
            for axes, values in zip(column, ([f.me_mm for f in made], [f.shear_median_mm for f in made]), strict=True):
                axes.plot(conditions, values, "o-", color=colour, label=profile)
        for axes, title in zip(column, (f"{family}: ME in mm", "median error of the shear in mm"), strict=True):
            axes.set(title=title, ylim=(0, None))
            axes.spines[["top", "right"]].set_visible(False)
            axes.grid(color="#e6e6e6", linewidth=0.8)
            axes.tick_params(axis="x", labelsize=7)
        column[0].legend(frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
