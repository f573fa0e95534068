"""Strict CSV tables: a mistake is told as ``FILE:LINE: column: found …, expected …``."""

from __future__ import annotations

import codecs
import csv
import io
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class Table:
    """A table of which some columns are known, in any order.

    Attributes
    ----------
    rows : tuple of (``FILE:LINE``, column to cell)
    unknown : tuple of str
        Columns that are not known, in the table's order.
    decimal_comma : bool
        Its columns are set apart by something else than commas: a comma in a number is its decimal sign.
    """

    rows: tuple[tuple[str, dict[str, str]], ...]
    unknown: tuple[str, ...]
    decimal_comma: bool


def read_columns(path: Path, required: tuple[str, ...], optional: tuple[str, ...], what: str) -> Table:
    """Read a table as a person's spreadsheet writes it: columns in any order, ``,``, ``;`` or tabs, UTF-8 or UTF-16.

    UTF-16 needs its byte order mark, which spreadsheets write. Rows without any cell are passed over.

    Raises
    ------
    ConfigError
        Not readable, not CSV, a column missing or there twice, or a row of another length.
    """
    try:
        data = path.read_bytes()
        text = data.decode("utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig")
        first = text.partition("\n")[0]
        delimiter = max(",;\t", key=first.count)
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        lines = [(reader.line_num, row) for row in reader if any(row)]
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}, expected a CSV file of {what}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: not a CSV file: {error}") from None
    header = [name.strip() for name in lines[0][1]] if lines else []
    if missing := [name for name in required if name not in header]:
        found = f"the header {delimiter.join(header)[:80]}" if header else "the header nothing"
        raise ConfigError(f"{path}:1: found {found}, expected {','.join(required)}: {', '.join(missing)} missing")
    line0, known = lines[0][0], (*required, *optional)
    if twice := [name for name in known if header.count(name) > 1]:
        raise ConfigError(f"{path}:{line0}: {twice[0]}: found {header.count(twice[0])} such columns, expected one")
    for line, row in lines[1:]:
        if len(row) != len(header):
            raise ConfigError(f"{path}:{line}: found {len(row)} columns, expected {len(header)}")
    rows = tuple((f"{path}:{line}", dict(zip(header, row, strict=True))) for line, row in lines[1:])
    return Table(rows, tuple(name for name in header if name not in known), delimiter != ",")


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
