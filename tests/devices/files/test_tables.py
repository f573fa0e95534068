from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.devices.files.tables import number, read_rows
from tacshade_edge.errors import ConfigError


def test_rows_know_their_line(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("a,b\n1,2\n\n3,4\n")
    assert read_rows(path, ("a", "b"), "numbers") == [(f"{path}:2", ["1", "2"]), (f"{path}:4", ["3", "4"])]


@pytest.mark.parametrize(
    ("text", "said"),
    [("", ":1: found the header nothing, expected a,b"), ("a,b\n1\n", ":2: found 1 columns, expected 2")],
)
def test_another_form_is_told(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_rows(tmp_path / "t.csv", ("a", "b"), "numbers")


def test_an_absent_table(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: No such file or directory, expected a CSV file of numbers"):
        read_rows(tmp_path / "none.csv", ("a", "b"), "numbers")


def test_a_number_is_finite() -> None:
    assert number("t.csv:2", "x_mm", "-1e-3") == -0.001
    for text in ("", "nan", "inf", "1,5", "x"):
        with pytest.raises(ConfigError, match=r"^t\.csv:2: x_mm: found .*, expected a number$"):
            number("t.csv:2", "x_mm", text)
