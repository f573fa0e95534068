from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from support.trade_points import point

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.tradeoff import board_report

FACTS = {
    "board": "Pi",
    "processor": "Cortex-A76",
    "cores": "4, up to 2400 MHz",
    "tacshade-edge": "1.0.0",
    "after": "61",
}
POINTS = [point("fast", 0.2, 1.0), replace(point("accurate", 0.1, 3.0), idle_p50_ms=0.5)]
DOCUMENT = Path(__file__).parents[3] / "docs/reference/boards.md"


def test_the_block_has_the_boards_row_and_what_else_is_known() -> None:
    header, rule, row, *rest = board_report.block(FACTS, POINTS, 1.04).splitlines()
    assert header == f"| {' | '.join(board_report.HEADER)} |"
    assert row == (
        "| Pi | Cortex-A76, 4 cores | unknown | 1.0.0 | 1.00 / 2.00 |  | 3.00 / 6.00 | 0.30 to 0.50 | 12 | 1.0 |"
    )
    assert header.count("|") == rule.count("|") == row.count("|")
    assert [line for line in rest if line] == [f"- {name}: {text}" for name, text in FACTS.items()]


def test_what_a_setting_differs_in_is_no_row() -> None:
    varied = point(replace(PROFILES["fast"], stride_px=8), 0.4, 2.0)
    assert board_report.row(FACTS, [varied], 1.0).endswith("| 1.0.0 |  |  |  |  |  | 1.0 |")


def test_the_documents_table_takes_the_rows() -> None:
    rows = [line for line in DOCUMENT.read_text().splitlines() if line.startswith("|")]
    assert rows[0] == f"| {' | '.join(board_report.HEADER)} |"
    assert {row.count("|") for row in rows} == {len(board_report.HEADER) + 1}
