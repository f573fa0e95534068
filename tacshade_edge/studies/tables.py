"""Format rows as tables for programs (CSV) and people (Markdown)."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

_WORDS = ("object", "method", "sensor", "what")
"""Leading columns with these names are left-aligned."""


def csv_text(kind: type[Any], rows: Sequence[Any]) -> str:
    """CSV with a line for each row and a column for each field of the dataclass `kind`; NaN is empty."""
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
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return value


def markdown(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table with padded columns, readable in a terminal too; numbers are right-aligned."""
    widths = [max(len(str(line[k])) for line in (header, *lines)) for k in range(len(header))]
    left = sum(name in _WORDS for name in header)

    def row(cells: Sequence[str]) -> str:
        padded = (c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(cells, widths, strict=True)))
        return f"| {' | '.join(padded)} |"

    rule = [":" + "-" * (w - 1) if k < left else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    return "\n".join([row(header), row(rule), *(row(line) for line in lines)])
