"""Reads CSV tables strictly and reports a mistake as ``FILE:LINE: column: found …, expected …``."""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import re
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TextIO

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import open_regular

ROWS_MAX: Final = 10_000
NUMBER_MAX: Final = 1e6
"""Greatest number in a table, far above any length in mm, angle or time in s."""

CRC_COLUMN: Final = "crc32"

_SEPARATOR: Final = re.compile(r"\"?sep=([,;\t])\"?\s*")
_NUMBER: Final = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", re.ASCII)
_BYTES_A_ROW_MAX: Final = 512  # on average
_ROW_CHARS_MAX: Final = 1 << 16


def read_rows(
    path: Path, header: tuple[str, ...], what: str, *, more: tuple[str, ...] = (), rows_max: int = ROWS_MAX
) -> list[tuple[str, list[str]]]:
    """Read a table with exactly this header as a list, with the arguments and errors of `iter_rows`."""
    return list(iter_rows(path, header, what, more=more, rows_max=rows_max))


def iter_rows(
    path: Path,
    header: tuple[str, ...],
    what: str,
    *,
    more: tuple[str, ...] = (),
    cut_off: bool = False,
    rows_max: int = ROWS_MAX,
    on_damage: Callable[[str], None] | None = None,
) -> Iterator[tuple[str, list[str]]]:
    """Read a table with exactly this header, row by row (``FILE:LINE``, columns), skipping empty lines.

    A table may end after any of the optional columns `more`. If its header ends with `CRC_COLUMN`, each line ends with
    its `line_crc32`, which is not yielded; lines with a wrong one are left out and reported to `on_damage` by
    ``FILE:LINE``, and so is a damaged header if the lines after it have theirs. With `cut_off`, the writer crashed, so
    an unterminated last line is left out. Raises ConfigError if the file is unreadable or not CSV, has another header,
    a row of another length, or too many rows; `what` names the kind of rows.
    """
    with _opened(path, what, rows_max, "surrogateescape") as stream:
        text = _text(path, stream)
        start = list(itertools.islice(text, 3))  # the header, which damage may split in two
        text = itertools.chain(start, text)
        kept = _Kept(path, _whole_lines(text) if cut_off else text)
        kept.on_damage = (lambda line: on_damage(f"{path}:{line}")) if on_damage else None
        lines = _lines(path, kept, ",", rows_max)
        headers = {header + more[:count] for count in range(len(more) + 1)}
        checked = CRC_COLUMN in more and any(map(_is_checked, start[1:]))
        if checked and start[0].rstrip("\r\n") not in map(",".join, headers):
            kept.checked, first = True, [*header, *more]
        else:
            line0, first = next(lines, (1, []))
            if tuple(first) not in headers:
                found = f"the header {shown(','.join(first), 80)}" if first else "no header"
                raise ConfigError(f"{path}:{line0}: found {found}, expected {','.join(header + more)}")
            kept.checked = checked = first[-1] == CRC_COLUMN
        for line, row in lines:
            if len(row) != len(first):
                raise ConfigError(f"{path}:{line + kept.left_out}: found {len(row)} columns, expected {len(first)}")
            yield f"{path}:{line + kept.left_out}", row[:-1] if checked else row


def line_crc32(columns: str) -> str:
    """The last cell of a line: zlib's CRC-32 of everything before its last comma, in eight hexadecimal digits."""
    return f"{zlib.crc32(columns.encode(errors='surrogateescape')):08x}"


def _is_checked(line: str) -> bool:
    columns, _, crc32 = line.rstrip("\r\n").rpartition(",")
    return crc32 == line_crc32(columns)


class _Kept:
    """The lines of a table; once `checked` is set, without those with a wrong checksum."""

    def __init__(self, path: Path, lines: Iterable[str]) -> None:
        self._path = path
        self._lines = lines
        self.checked = False
        self.left_out = 0
        self.on_damage: Callable[[int], None] | None = None

    def __iter__(self) -> Iterator[str]:
        for number, line in enumerate(self._lines, 1):
            if not self.checked:
                self._require_text(line)
                yield line
                continue
            if _is_checked(line):
                yield line
                continue
            self.left_out += 1
            if self.on_damage is not None:
                self.on_damage(number)

    def _require_text(self, line: str) -> None:
        try:
            line.encode(errors="surrogateescape").decode()
        except UnicodeDecodeError as error:
            raise ConfigError(f"{self._path}: not a CSV file: {error}") from None


@dataclass(frozen=True, slots=True)
class Table:
    """A table with known and unknown columns in any order; rows are ``FILE:LINE`` and column to cell.

    With a decimal comma, the delimiter is not a comma, so a comma in a number is the decimal sign.
    """

    rows: tuple[tuple[str, dict[str, str]], ...]
    unknown: tuple[str, ...]
    decimal_comma: bool

    def with_points(self, row: dict[str, str], texts: Collection[str] = ("image",)) -> dict[str, str]:
        """A row's cells with decimal points, except the columns of `texts`."""
        if not self.decimal_comma:
            return row
        return {key: cell if key in texts else cell.replace(",", ".") for key, cell in row.items()}


def read_columns(
    path: Path, required: tuple[str, ...], optional: tuple[str, ...], what: str, *, rows_max: int = ROWS_MAX
) -> Table:
    """Read a table as a spreadsheet writes it: columns in any order, ``,``, ``;`` or tabs, UTF-8 or UTF-16.

    UTF-16 needs its byte order mark, which spreadsheets write. The first line may be Excel's ``sep=;``. Blanks around
    cells, empty cells after the last column and rows without any filled cell are skipped. Raises ConfigError if the
    file is unreadable or not CSV, a column is missing or repeated, or a row has another length.
    """
    with _opened(path, what, rows_max) as stream:
        text = _text(path, stream)
        first = next(text, "")
        stated = _SEPARATOR.fullmatch(first)
        names = {each: {name.strip('" \t\r\n') for name in first.split(each)} for each in ",;\t"}
        delimiter = stated[1] if stated else max(names, key=lambda each: len(names[each].intersection(required)))
        read = _lines(path, itertools.chain(["\n" if stated else first], text), delimiter, rows_max)
        lines = [(line, cells) for line, row in read if any(cells := [cell.strip() for cell in row])]
    line0, header = lines[0] if lines else (1, [])
    while header and not header[-1]:
        header.pop()
    if missing := [name for name in required if name not in header]:
        found = f"the header {shown(delimiter.join(header), 80)}" if header else "no header"
        raise ConfigError(
            f"{path}:{line0}: found {found}, expected {','.join(required)}; the header lacks {', '.join(missing)}"
        )
    known = (*required, *optional)
    if twice := [name for name in known if header.count(name) > 1]:
        raise ConfigError(
            f"{path}:{line0}: {twice[0]}: found {header.count(twice[0])} columns with this name, expected one"
        )
    for line, cells in lines[1:]:
        if len(cells) < len(header) or any(cells[len(header) :]):
            raise ConfigError(f"{path}:{line}: found {len(cells)} columns, expected {len(header)}")
    rows = tuple((f"{path}:{line}", dict(zip(header, cells, strict=False))) for line, cells in lines[1:])
    return Table(rows, tuple(name for name in header if name not in known), delimiter != ",")


def number(where: str, column: str, text: str) -> float:
    """Parse a number from -`NUMBER_MAX` to `NUMBER_MAX`. Raises ConfigError."""
    if not _NUMBER.fullmatch(text):  # float() reads 1_0 and the digits of other scripts too
        raise ConfigError(f"{where}: {column}: found {quoted(text)}, expected a number")
    value = float(text)
    if abs(value) > NUMBER_MAX:
        most = f"{NUMBER_MAX:g}"
        raise ConfigError(f"{where}: {column}: found {quoted(text)}, expected a number from -{most} to {most}")
    return value


def _opened(path: Path, what: str, rows_max: int, errors: str = "strict") -> TextIO:
    """Open a table's text, in UTF-8 or, with its byte order mark, UTF-16. Raises ConfigError."""
    try:
        stream = open_regular(path, rows_max * _BYTES_A_ROW_MAX)
        start = stream.read(2)
        stream.seek(0)
    except OSError as error:
        raise ConfigError(f"{shown(path)}: {error.strerror or error}, expected a CSV file of {what}") from None
    encoding = "utf-16" if start in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"
    return io.TextIOWrapper(stream, encoding, errors, newline="")


def _text(path: Path, stream: TextIO) -> Iterator[str]:
    """The file's lines with their ends, split where they exceed the limit. Raises ConfigError."""
    try:
        while line := stream.readline(_ROW_CHARS_MAX + 1):
            yield line
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a CSV file: {error}") from None


def _lines(path: Path, text: Iterable[str], delimiter: str, rows_max: int) -> Iterator[tuple[int, list[str]]]:
    """Each non-empty row with the number of its last line. Raises ConfigError."""
    taken = 0

    def bounded() -> Iterator[str]:
        nonlocal taken
        for line in text:
            taken += len(line)
            if taken > _ROW_CHARS_MAX:
                raise csv.Error(f"a row of more than {_ROW_CHARS_MAX} characters")
            yield line

    reader = csv.reader(bounded(), delimiter=delimiter, strict=True, skipinitialspace=True)
    rows = 0
    try:
        for row in reader:
            taken = 0
            if not row:
                continue
            if rows > rows_max:  # the header is one more
                raise ConfigError(
                    f"{path}:{reader.line_num}: found more than {rows_max} rows, expected at most {rows_max}"
                )
            rows += 1
            yield reader.line_num, row
    except csv.Error as error:
        raise ConfigError(f"{path}:{reader.line_num + 1}: not a CSV file: {error}") from None


def _whole_lines(lines: Iterable[str]) -> Iterator[str]:
    return (line for line in lines if line.endswith("\n"))
