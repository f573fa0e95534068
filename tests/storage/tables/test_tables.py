from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.tables.tables import number, read_columns, read_rows


def test_rows_know_their_line(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("a,b\n1,2\n\n3,4\n")
    assert read_rows(path, ("a", "b"), "numbers") == [(f"{path}:2", ["1", "2"]), (f"{path}:4", ["3", "4"])]


def test_a_number_is_finite() -> None:
    assert number("t.csv:2", "x_mm", "-1e-3") == -0.001
    for text in ("", "nan", "inf", "1,5", "x"):
        with pytest.raises(ConfigError, match=r"^t\.csv:2: x_mm: found .*, expected a number$"):
            number("t.csv:2", "x_mm", text)


def test_a_number_that_nothing_here_has_is_refused() -> None:
    for text in ("1e300", "-1000001", "1e7"):
        with pytest.raises(ConfigError, match=rf"^t\.csv:2: x_mm: found '{text}', expected a number from -1e\+06 to"):
            number("t.csv:2", "x_mm", text)


def test_what_is_told_of_a_cell_is_one_short_line() -> None:
    with pytest.raises(ConfigError) as refusal:
        number("t.csv:2", "x_mm", "\x1b[2J\n" * 10_000)
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 400


def test_a_table_has_a_most_of_rows(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("a,b\n" + "1,2\n" * 4)
    assert len(read_rows(path, ("a", "b"), "numbers", rows_max=4)) == 4
    with pytest.raises(ConfigError, match=r"t\.csv:5: found more than 3 rows, expected at most 3"):
        read_rows(path, ("a", "b"), "numbers", rows_max=3)


@pytest.mark.parametrize(
    "row",
    [
        pytest.param("," * 10**6, id="columns"),
        pytest.param('"' + "x" * 10**6, id="a cell"),
        pytest.param('"\n",' * 10**6, id="lines of one row"),
        pytest.param('"' + "\n" * 10**6, id="a cell of lines"),
    ],
)
def test_a_row_without_end_takes_no_memory(tmp_path: Path, row: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"a,b\n1,2\n{row}")
    tracemalloc.start()
    for read in (
        lambda: read_rows(path, ("a", "b"), "numbers"),
        lambda: read_columns(path, ("a", "b"), (), "numbers"),
    ):
        with pytest.raises(ConfigError, match=r"t\.csv:\d+: not a CSV file: "):
            read()
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


def test_only_a_regular_file_is_a_table(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "t.csv")
    with pytest.raises(ConfigError, match=r"t\.csv: found no regular file, expected a CSV file of numbers"):
        read_rows(tmp_path / "t.csv", ("a", "b"), "numbers")


@pytest.mark.parametrize(
    "text",
    [
        "a, b\n1.5, two\n",
        "a ,b \n 1.5 ,two \n",
        '"a", "b"\n"1.5", "two"\n',
        "sep=;\na;b\n1,5;two\n",
        '"sep=;"\r\na;b\r\n1,5;two\r\n',
        "sep=,\na,b\n1.5,two\n",
        "\ufeffsep=;\na;b\n1,5;two\n",
        "a,b\n1.5,two,\n",
        "a,b,,\n1.5,two\n",
        "a;b;;\n1,5;two;;;\n;;\n",
    ],
)
def test_a_table_as_spreadsheets_and_people_write_it(tmp_path: Path, text: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8", newline="")
    table = read_columns(path, ("a", "b"), (), "numbers")
    ((where, row),) = [(where, table.with_points(row, ("b",))) for where, row in table.rows]
    assert (row, table.unknown) == ({"a": "1.5", "b": "two"}, ())
    assert where == f"{path}:{3 if 'sep' in text else 2}"
