"""Write rows as tables for programs (CSV, JSON) and people (Markdown), and as plots;
only plots import matplotlib.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Any, TypeVar

Row = TypeVar("Row")

_WORDS = ("object", "method", "sensor", "what")
"""Leading columns with these names are left-aligned."""


def csv_text(kind: type[Any], rows: Sequence[Any]) -> str:
    """CSV with a line for each row and a column for each field of the dataclass `kind`;
    NaN is empty.
    """
    names = [field.name for field in fields(kind)]
    return csv_lines(names, [[getattr(row, name) for name in names] for row in rows])


def csv_lines(header: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    """CSV of a header and lines; NaN is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_plain(value) for value in line] for line in lines)
    return stream.getvalue()


def _plain(value: object) -> object:
    # A bool is an int to Python, and would be written as True.
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float):
        # Six digits: more than any figure here is worth, and the same on every machine.
        return "" if math.isnan(value) else f"{value:.6g}"
    return value


def markdown(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table with padded columns, readable in a terminal too;
    numbers are right-aligned.
    """
    widths = [max(len(str(line[k])) for line in (header, *lines)) for k in range(len(header))]
    left = sum(name in _WORDS for name in header)

    def row(cells: Sequence[str]) -> str:
        padded = (
            c.ljust(w) if k < left else c.rjust(w)
            for k, (c, w) in enumerate(zip(cells, widths, strict=True))
        )
        return f"| {' | '.join(padded)} |"

    # Colons align the columns where Markdown is shown; padding does in a terminal.
    rule = [":" + "-" * (w - 1) if k < left else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    return "\n".join([row(header), row(rule), *(row(line) for line in lines)])


def summary(
    names: Sequence[str],
    groups: Iterable[tuple[Sequence[str], Sequence[Row]]],
    figures: Mapping[str, Callable[[Sequence[Row]], str]],
) -> str:
    """A Markdown table with a line for each group: its names, then each figure of its rows."""
    lines = [(*name, *(figure(some) for figure in figures.values())) for name, some in groups]
    return markdown((*names, *figures), lines)


def grouped(rows: Iterable[Row], by: str | Callable[[Row], Any]) -> dict[Any, list[Row]]:
    """Rows by the value of an attribute or a function,
    in the order in which the values first appear.
    """
    groups: dict[Any, list[Row]] = {}
    value = attrgetter(by) if isinstance(by, str) else by
    for row in rows:
        # Not itertools.groupby, which would need sorted rows and lose their order.
        groups.setdefault(value(row), []).append(row)
    return groups


def number(value: float, spec: str) -> str:
    """A number as a cell; empty for NaN."""
    return "" if math.isnan(value) else format(value, spec)


def without_nan(value: Any) -> Any:
    """Replace NaN by None, because JSON lacks NaN."""
    if isinstance(value, dict):
        return {key: without_nan(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    # json would write NaN, which other readers refuse.
    return None if isinstance(value, float) and math.isnan(value) else value


def new_figure(
    rows: int, columns: int, width: float, height: float, dpi: int = 100
) -> tuple[Any, Any]:
    """A figure of a size in inches, and its axes (rows, columns) with a light grid."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Not pyplot, which keeps figures alive and looks for a screen.
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.spines[["top", "right"]].set_visible(False)
        each.grid(color="#e6e6e6", linewidth=0.8)
        # The grid behind the points, not through them.
        each.set_axisbelow(True)
    return figure, axes


def png(figure: Any) -> bytes:
    """A figure as a PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
