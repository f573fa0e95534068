"""How many intervals hold over depth, and the error over σ: a column for each family, a line for each profile.

matplotlib is imported to draw only.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from tools.studies.sigma.summary import family_of, figures, joined
from tools.studies.sigma.work import Found

_COLOURS = ("#3d6fb4", "#e4572e", "#4a9c5d")
_LOW, _HIGH = 85, 95
"""Accepted coverage of 90 % intervals, %."""


def draw(found: Sequence[Found]) -> bytes:
    """A PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    families = list(dict.fromkeys(map(family_of, found)))
    figure = Figure(figsize=(5.5 * len(families), 7), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    for column, family in zip(figure.subplots(2, len(families), squeeze=False).T, families, strict=True):
        mine = [each for each in found if family_of(each) == family]
        column[0].axhspan(_LOW, _HIGH, color="#eeeeee")
        for colour, profile in zip(_COLOURS, dict.fromkeys(each.row.profile for each in mine), strict=False):
            of = [each for each in mine if each.row.profile == profile]
            for dragged, style in ((False, "o-"), (True, "s--")):
                some = [each for each in of if (each.row.drag_mm > 0) == dragged]
                depths = sorted({each.row.depth_mm for each in some})
                covered = [100 * figures([e for e in some if e.row.depth_mm == depth]).covered for depth in depths]
                column[0].plot(depths, covered, style, color=colour, label=f"{profile}{', dragged' if dragged else ''}")
            error_mm, sigma_mm = joined(of)
            tenths = np.array_split(np.argsort(sigma_mm), 10)
            column[1].plot(
                [sigma_mm[tenth].mean() for tenth in tenths],
                [error_mm[tenth].mean() for tenth in tenths],
                "o-",
                color=colour,
            )
        column[0].set(title=f"{family}: cells in their 90 % interval, %", xlabel="depth, mm", ylim=(40, 100))
        column[1].set(title="mean error of each tenth of the cells, mm", xlabel="its mean σ, mm")
        column[1].set(xlim=(0, None), ylim=(0, None))
        for axes in column:
            axes.spines[["top", "right"]].set_visible(False)
            axes.grid(color="#e6e6e6", linewidth=0.8)
        column[0].legend(frameon=False, fontsize=7)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
