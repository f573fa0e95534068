"""The tables of a page of docs/results, and what claims about them have in common."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROFILES = ("accurate", "balanced", "fast")
LIMITS_ORDER = ("fast", "balanced", "accurate")
FAMILIES = {"training family": "tacshade", "other family": "other"}
WORDS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
Claims = Iterable[str]
"""Sentences and lines; spaces and line ends count alike."""


def flat(text: str) -> str:
    """With single spaces, so that a claim may run over lines."""
    return " ".join(text.split())


def rounded(value: str | float, digits: int) -> str:
    """A half goes up, as a reader rounds; what was computed is taken to a millionth."""
    exact = Decimal(value) if isinstance(value, str) else Decimal(f"{value:.6f}")
    return str(exact.quantize(Decimal(1).scaleb(-digits), ROUND_HALF_UP))


class Page:
    """The tables of a page, of one family of sensors on it, or below one of its headings."""

    def __init__(self, name: str, family: str = "", part: str = "") -> None:
        text = (ROOT / "docs" / "results" / f"{name}.md").read_text(encoding="utf-8")
        if family:
            parts = re.split(r"^(?:Family (\w+)|Both families)$", text, flags=re.MULTILINE)
            text = parts[parts.index(family) + 1]
        if part:
            text = text.partition(f"## {part}\n")[2].partition("\n## ")[0]
        self.name = name
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

    def cell(self, column: str, *row: str) -> str:
        """The same, of which there is one."""
        found = self.cells(column, *row)
        assert len(found) == 1, f"{self.name}: {len(found)} cells {column!r} in lines {row}"
        return found[0]

    def number(self, column: str, *row: str) -> float:
        return float(self.cell(column, *row))

    def header(self, column: str) -> list[str]:
        """The column names of the table that has `column`."""
        (header,) = (table[0] for table in self._tables if column in table[0])
        return header
