import csv
import io
import json
import math
from dataclasses import replace

from support.trade_points import point

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.tradeoff import report
from tacshade_edge.studies.tradeoff.summary import Estimate

UNKNOWN = Estimate(math.nan, math.nan, math.nan)
POINTS = [
    point("fast", 0.2, 1.0, front=True),
    replace(point(replace(PROFILES["fast"], stride_px=8), 0.4, 2.0), p50_ms=Estimate(2.0, math.nan, math.nan)),
    replace(point("accurate", 0.1, 3.0), iou=UNKNOWN),
]


def test_the_tables_have_a_line_for_each_setting_and_the_intervals() -> None:
    settings, _, stages = report.table(POINTS).split("\n\n")
    shipped, varied, accurate = settings.splitlines()[2:]
    assert "| fast     | **as shipped** | 0.200 (0.180 to 0.220) |" in shipped
    assert "| 1.00 (0.90 to 1.10) |" in shipped
    assert shipped.endswith("|   yes |")
    assert "| stride 8 px    |" in varied
    assert "|                2.00 |" in varied
    assert "|      |" in accurate
    assert "0.10 / 0.20" in stages
    assert len(stages.splitlines()) == 5


def test_the_csv_has_a_column_for_each_figure_and_nothing_for_nan() -> None:
    lines = list(csv.DictReader(io.StringIO(report.csv_text(POINTS))))
    assert [line["setting"] for line in lines] == ["fast", "fast, stride 8 px", "accurate"]
    assert [(line["shipped"], line["front"]) for line in lines] == [("1", "1"), ("0", "0"), ("1", "0")]
    assert (lines[0]["me_mm"], lines[0]["me_mm_low"], lines[1]["p50_ms_low"]) == ("0.2", "0.18", "")
    assert (lines[0]["gate_p99_ms"], lines[0]["depth_p50_ms"]) == ("0.4", "")
    assert {len(line) for line in lines} == {len(report.record(POINTS[0]))}


def test_the_document_is_json_without_nan() -> None:
    made = report.document(POINTS, {"sensors": ["default"]}, 1.02)
    again = json.loads(json.dumps(made, allow_nan=False))
    assert again["points"][2]["iou"] is None
    assert again["board"]["busy"] == 1.02
    assert again["data"] == {"sensors": ["default"]}
    assert again["versions"]["numpy"]
