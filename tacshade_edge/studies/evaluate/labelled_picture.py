"""Plot found against known values, a panel per quantity and a colour per profile; only drawing imports matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np

from tacshade_edge.studies.evaluate.labelled import FoundRow

PANELS = (
    ("depth_mm", "depth_mm", "depth, mm"),
    ("volume_mm3", "depth_mm", "volume, mm³"),
    ("tilt_x_deg", "tilt_x_deg", "tilt about x, °"),
    ("tilt_y_deg", "tilt_y_deg", "tilt about y, °"),
    ("shear_x_mm", "shear_x_mm", "shear along x, mm"),
    ("shear_y_mm", "shear_y_mm", "shear along y, mm"),
)


def draw(rows: Mapping[str, Sequence[FoundRow]], known: Sequence[Mapping[str, float]]) -> bytes:
    """Draw the plot as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 8), dpi=90, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (found, true, title) in zip(figure.subplots(2, 3).flat, PANELS, strict=True):
        for profile, some in rows.items():
            points = [
                (labels[true], getattr(row, found))
                for row, labels in zip(some, known, strict=True)
                if not row.refused and true in labels
            ]
            if points:
                axes.plot(*np.array(points).T, ".", markersize=3, alpha=0.5, label=profile)
        axes.set(title=title, xlabel=f"known: {true}", ylabel=f"found: {found}")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e6e6e6", linewidth=0.8)
    figure.axes[0].legend(frameon=False, loc="upper left")
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
