"""Reads CSV tables strictly and reports a mistake as ``FILE:LINE: column: found …, expected …``;
writes them.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.file_kinds import kind_of
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import decoded, read_regular

ROWS_MAX: Final = 10_000
NUMBER_MAX: Final = 1e6
"""Greatest number in a table, far above any length in mm, angle or time in s."""
# On average, so that the file's size bounds what is read.
BYTES_A_ROW_MAX: Final = 512
_ROW_CHARS_MAX: Final = 1 << 16

_LINE: Final = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_SEPARATOR: Final = re.compile(r"\"?sep=([,;\t])\"?\s*")
_NUMBER: Final = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", re.ASCII)
# Columns whose commas are no decimal signs.
_TEXTS: Final = frozenset({"image", "indenter", "group"})
# What R writes in an empty cell.
_R_EMPTY: Final = "NA"
# How pandas, R and others name the numbers of rows that they write as a column of their own.
_ROW_NUMBERS: Final = re.compile(r"|index|level_0|Unnamed: \d+(\.\d+)*")

Rows = list[tuple[str, dict[str, str]]]
"""Each row's ``FILE:LINE`` and its cells by column, with decimal points;
"" where an optional column is missing.
"""
Lines = Sequence[tuple[int, list[str]]]
"""The number and the cells of lines."""


def read_columns(
    path: Path,
    required: tuple[str, ...],
    optional: tuple[str, ...],
    what: str,
    *,
    rows_max: int = ROWS_MAX,
) -> tuple[Rows, tuple[str, ...]]:
    """Read a table as a spreadsheet writes it; returns the rows and the names of unknown columns.

    The columns may be in any order, separated by ``,``, ``;``, tabs or, as R does, blanks, the text
    UTF-8 or, with its byte order mark, UTF-16. The first line may be Excel's ``sep=;``. A comma in
    a number is the decimal sign, unless other numbers of a table with ``,`` have points. A number
    ``NA`` is an empty cell. Blanks around cells, empty cells after the last column, rows without
    any filled cell and a column of row numbers, as pandas writes or, without a name, R, are
    skipped. Raises ConfigError if the file is unreadable or not CSV, a column is missing or
    repeated, or a row has another length; `what` names the rows.
    """
    text, delimiter = _separated(_text(path, what, rows_max * BYTES_A_ROW_MAX), required)
    lines = _lines(path, text, delimiter, rows_max)
    line0, header = lines[0] if lines else (1, [])
    if _has_row_names(header, lines[1:]):
        header.insert(0, "")
    # Spreadsheets end every row with the separators of columns that were once used.
    while header and not header[-1]:
        header.pop()
    known = (*required, *optional)
    _check_header(f"{path}:{line0}", header, required, known, delimiter)
    _check_lengths(path, header, lines[1:])
    numbers = [k for k, name in enumerate(header) if name in known and name not in _TEXTS]
    _make_plain(lines[1:], numbers, delimiter)
    place = {name: header.index(name) for name in known if name in header}
    rows = [
        (
            f"{path}:{line}",
            {name: cells[place[name]] if name in place else "" for name in known},
        )
        for line, cells in lines[1:]
    ]
    unknown = (
        name
        for k, name in enumerate(header)
        if name not in known and not _counts_rows(name, [cells[k] for _, cells in lines[1:]])
    )
    return rows, tuple(unknown)


def _make_plain(lines: Lines, numbers: Sequence[int], delimiter: str) -> None:
    """Write the cells of columns of numbers with decimal points, and nothing where R has no value.

    Spreadsheets of many countries write a decimal comma, and then separate by another sign or quote
    the number; with points elsewhere, it would separate thousands.
    """
    has_points = any("." in cells[k] for _, cells in lines for k in numbers)
    for _, cells in lines:
        for k in numbers:
            if cells[k] == _R_EMPTY:
                cells[k] = ""
            elif delimiter != "," or not has_points:
                cells[k] = cells[k].replace(",", ".")


def is_row_numbers(name: str) -> bool:
    """Whether a column's name is one that programs give to the numbers of the rows."""
    return _ROW_NUMBERS.fullmatch(name) is not None


def _has_row_names(header: Sequence[str], lines: Lines) -> bool:
    """Whether a header has no name for a first column that numbers the rows, as of R's write.table.

    Numbers alone: of other names, one cannot know that they come first.
    """
    first = {cells[0] for _, cells in lines if len(cells) == len(header) + 1}
    return bool(lines) and len(first) == len(lines) and all(map(_is_row_number, first))


def _check_lengths(path: Path, header: Sequence[str], lines: Lines) -> None:
    """Check that each row has the header's columns. Raises ConfigError."""
    longer = bool(lines) and all(len(cells) == len(header) + 1 and cells[-1] for _, cells in lines)
    hint = ": are the first R's row names? row.names = FALSE leaves them out" if longer else ""
    for line, cells in lines:
        if len(cells) < len(header) or any(cells[len(header) :]):
            raise ConfigError(
                f"{path}:{line}: found {len(cells)} columns, expected {len(header)}{hint}"
            )


def _is_row_number(cell: str) -> bool:
    return cell.isascii() and cell.isdecimal()


def _counts_rows(name: str, cells: Sequence[str]) -> bool:
    # An empty column before the table is one more habit of spreadsheets.
    return is_row_numbers(name) and all(not cell or _is_row_number(cell) for cell in cells)


def _separated(text: str, required: tuple[str, ...]) -> tuple[str, str]:
    """The text of the table, and its separator: the stated one, or else the one at which most
    required names appear.
    """
    first = begun[0] if (begun := _LINE.match(text)) else ""
    if stated := _SEPARATOR.fullmatch(first):
        # An empty line in its place keeps the line numbers as the file has them.
        return "\n" + text[len(first) :], stated[1]
    names = {each: {name.strip('" \t\r\n') for name in first.split(each)} for each in ",;\t "}
    return text, max(names, key=lambda each: len(names[each].intersection(required)))


def _lines(path: Path, text: str, delimiter: str, rows_max: int) -> list[tuple[int, list[str]]]:
    """The number and the cells of each row that has any, the header's first.

    Raises ConfigError.
    """
    taken = 0

    def bounded() -> Iterator[str]:
        # A quote that nobody closes makes one row of the rest of the file.
        nonlocal taken
        for found in _LINE.finditer(text):
            taken += len(found[0])
            if taken > _ROW_CHARS_MAX:
                raise csv.Error(f"a row of more than {_ROW_CHARS_MAX} characters")
            yield found[0]

    # `strict`: csv would otherwise repair a wrong quote by guessing.
    reader = csv.reader(bounded(), delimiter=delimiter, strict=True, skipinitialspace=True)
    lines: list[tuple[int, list[str]]] = []
    try:
        for row in reader:
            taken = 0
            if any(cells := [cell.strip() for cell in row]):
                lines.append((reader.line_num, cells))
            if len(lines) > rows_max + 1:
                found = f"found more than {rows_max} rows, expected at most {rows_max}"
                raise ConfigError(f"{path}:{reader.line_num}: {found}")
    except csv.Error as error:
        raise ConfigError(f"{path}:{reader.line_num + 1}: not a CSV file: {error}") from None
    return lines


def _check_header(
    where: str,
    header: Sequence[str],
    required: tuple[str, ...],
    known: tuple[str, ...],
    delimiter: str,
) -> None:
    """Check that the header has every required column, and no known one twice.

    Raises ConfigError.
    """
    if missing := [name for name in required if name not in header]:
        found = f"the header {shown(delimiter.join(header), 80)}" if header else "no header"
        raise ConfigError(
            f"{where}: found {found}, expected {','.join(required)}; the header lacks "
            f"{', '.join(missing)}"
        )
    if twice := [name for name in known if header.count(name) > 1]:
        raise ConfigError(
            f"{where}: {twice[0]}: found {header.count(twice[0])} columns with this name, "
            "expected one"
        )


def number(where: str, column: str, text: str) -> float:
    """Parse a number from -`NUMBER_MAX` to `NUMBER_MAX`. Raises ConfigError."""
    # float() also reads 1_0, nan, inf and the digits of other scripts.
    if not _NUMBER.fullmatch(text):
        raise ConfigError(f"{where}: {column}: found {quoted(text)}, expected a number")
    value = float(text)
    if abs(value) > NUMBER_MAX:
        most = f"{NUMBER_MAX:g}"
        raise ConfigError(
            f"{where}: {column}: found {quoted(text)}, expected a number from -{most} to {most}"
        )
    return value


def require_rows(path: Path, count: int) -> None:
    """Before a table is written: raise DeviceError for more rows than `read_columns` takes."""
    if count > ROWS_MAX:
        found = f"found {count} rows, expected at most {ROWS_MAX}"
        raise DeviceError(f"{path}: {found}; those before are kept, go on in a new folder")


def csv_bytes(header: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """A table's file."""
    stream = io.StringIO(newline="")
    csv.writer(stream, lineterminator="\n").writerows((header, *rows))
    return stream.getvalue().encode()


def _text(path: Path, what: str, bytes_max: int) -> str:
    try:
        data = read_regular(path, bytes_max)
    except OSError as error:
        raise ConfigError(
            f"{shown(path)}: {error.strerror or error}, expected a CSV file of {what}"
        ) from None
    try:
        return decoded(data)
    except UnicodeDecodeError as error:
        if kind := kind_of(data):
            raise ConfigError(f"{path}: found {kind}, expected a CSV file of {what}") from None
        line = data[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}: not a CSV file: {error}; save it as UTF-8") from None
