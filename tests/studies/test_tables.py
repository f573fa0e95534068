import math
from dataclasses import dataclass

from tacshade_edge.studies.tables import csv_text, markdown


@dataclass(frozen=True)
class Line:
    name: str
    found: bool
    depth_mm: float


def test_csv_has_a_column_for_each_field_and_nothing_for_nan() -> None:
    rows = [Line("a, b", True, 1.23456789), Line("", False, math.nan)]
    assert csv_text(Line, rows) == 'name,found,depth_mm\n"a, b",1,1.23457\n,0,\n'
    assert csv_text(Line, []) == "name,found,depth_mm\n"


def test_words_lean_left_and_numbers_right() -> None:
    assert markdown(["what", "mm"], [["light", "1.5"], ["", "10.25"]]).splitlines() == [
        "| what  |    mm |",
        "| :---- | ----: |",
        "| light |   1.5 |",
        "|       | 10.25 |",
    ]
