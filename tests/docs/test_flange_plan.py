"""The plan that the page gives a robot is the one that the study and the tests go through."""

import re
from pathlib import Path

from tools.testbed.flange_plan import TURNS_DEG

PAGE = Path(__file__).parents[2] / "docs/how-to/stitching.md"


def test_the_table_has_the_turns_of_the_plan() -> None:
    plan = PAGE.read_text(encoding="utf-8").partition("### The plan")[2].partition("###")[0]
    rows = re.findall(r"^\| [^|]*\| (-?\d+) \| (-?\d+) \| (-?\d+) \|$", plan, re.MULTILINE)
    assert [tuple(int(value) for value in row) for row in rows] == [turn for turns in TURNS_DEG for turn in turns]
