"""The tables of a page of docs/results."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


class Page:
    """The tables of a page."""

    def __init__(self, name: str) -> None:
        text = (ROOT / "docs" / "results" / f"{name}.md").read_text(encoding="utf-8")
        blocks = re.findall(r"(?:^\|.*\|\n)+", text + "\n", re.MULTILINE)
        self._tables = [
            [[cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()] for block in blocks
        ]

    def cells(self, column: str, *row: str) -> list[str]:
        """The column's cell in each line that begins with `row`."""
        found = []
        for header, _, *lines in self._tables:
            if column in header:
                found += [line[header.index(column)] for line in lines if tuple(line[: len(row)]) == row]
        return found
