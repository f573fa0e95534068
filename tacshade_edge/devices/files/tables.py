"""Strict CSV tables: a mistake is told as ``FILE:LINE: column: found …, expected …``."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

from tacshade_edge.errors import ConfigError


def read_rows(
    path: Path, header: tuple[str, ...], what: str, *, more: tuple[str, ...] = (), cut_off: bool = False
) -> list[tuple[str, list[str]]]:
    """Read a table with exactly this header; empty lines are passed over.

    Parameters
    ----------
    path : Path
    header : tuple of str
    what : str
        What the rows are, for a person.
    more : tuple of str
        Columns after those of `header`, all of which a table has or none.
    cut_off : bool
        Its writer died: a last line without an end is left out.

    Returns
    -------
    list of (``FILE:LINE``, columns)

    Raises
    ------
    ConfigError
        Not readable, not CSV, another header, or a row of another length.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(_whole_lines(stream) if cut_off else stream, strict=True)
            lines = [(reader.line_num, row) for row in reader if row]
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}, expected a CSV file of {what}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: not a CSV file: {error}") from None
    if not lines or tuple(lines[0][1]) not in (header, header + more):
        found = ",".join(lines[0][1]) if lines else "nothing"
        raise ConfigError(f"{path}:1: found the header {found[:80]}, expected {','.join(header + more)}")
    columns = len(lines[0][1])
    for line, row in lines[1:]:
        if len(row) != columns:
            raise ConfigError(f"{path}:{line}: found {len(row)} columns, expected {columns}")
    return [(f"{path}:{line}", row) for line, row in lines[1:]]


def _whole_lines(lines: Iterable[str]) -> Iterator[str]:
    return (line for line in lines if line.endswith("\n"))


def number(where: str, column: str, text: str) -> float:
    """A finite number. Raises ConfigError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where}: {column}: found {text!r}, expected a number")
    return value
