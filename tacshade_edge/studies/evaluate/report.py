"""Format an evaluation for people (tables) and programs (CSV, JSON)."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.studies import tables
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.summary import (
    TABLE_I,
    Figures,
    beats_table_i,
    by_object,
    figures,
    null_figures,
    worst,
)
from tacshade_edge.studies.evaluate.work import Timing

PACKAGES = ("tacshade-edge", "numpy", "opencv-contrib-python-headless", "onnxruntime", "scipy")
MEASURES = ("ME mm", "back mm", "SD %", "SD sum %", "IoU", "depth off %", "worst %", "missed")
PAPER_ROW = "Table I (real sensor)"


def table(rows: Sequence[Row], timings: Mapping[str, Timing]) -> str:
    """Markdown tables, readable as plain text too: objects, sensors and profiles, separately for each family."""
    families = list(dict.fromkeys(_family(r) for r in rows))
    if len(families) < 2:
        return _family_table(rows, timings)
    parts = ((family, _family_table([r for r in rows if _family(r) == family], timings)) for family in families)
    return "\n\n".join(f"Family {family}\n\n{text}" for family, text in parts)


def _family(row: Row) -> str:
    return row.sensor.rpartition(":")[0] or "tacshade"


def _family_table(rows: Sequence[Row], timings: Mapping[str, Timing]) -> str:
    profiles = list(dict.fromkeys(r.profile for r in rows))
    objects = list(dict.fromkeys(r.object for r in rows if r.true_points))
    blocks = (
        ("The paper's five objects", [o for o in objects if o in PAPER_OBJECTS]),
        ("Other objects", [o for o in objects if o not in PAPER_OBJECTS]),
    )
    parts = [_objects_table(title, rows, profiles, names) for title, names in blocks if names]
    if objects:
        parts.append(_sensors_table(rows, profiles))
    parts.append(_profiles_table(rows, profiles, timings))
    return "\n\n".join(parts)


def _objects_table(title: str, rows: Sequence[Row], profiles: Sequence[str], names: Sequence[str]) -> str:
    lines = []
    per_profile = {p: by_object(r for r in rows if r.profile == p and r.object in names) for p in profiles}
    paper = {name: TABLE_I[name] for name in names if name in TABLE_I}
    for name in names:
        if name in paper:
            lines.append([name, PAPER_ROW, *_paper_cells(*paper[name])])
        lines += [[name, p, *_cells(found[name])] for p, found in per_profile.items()]
    if len(names) > 1:
        for title_of_row, pick in (("mean", _mean_of_paper), ("worst object", _worst_of_paper)):
            if len(paper) == len(names):
                lines.append([title_of_row, PAPER_ROW, *_paper_cells(*pick(list(paper.values())))])
            for p, found in per_profile.items():
                some = [r for r in rows if r.profile == p and r.object in names]
                total = figures(some) if title_of_row == "mean" else worst(list(found.values()))
                lines.append([title_of_row, p, *_cells(total)])
    return f"{title}\n\n" + tables.markdown(["object", "method", *MEASURES], lines)


def _sensors_table(rows: Sequence[Row], profiles: Sequence[str]) -> str:
    lines = []
    for sensor in dict.fromkeys(r.sensor for r in rows):
        for profile in profiles:
            some = [r for r in rows if r.sensor == sensor and r.profile == profile]
            lines.append([sensor, profile, *_cells(figures(some))])
    return "Each sensor, all objects\n\n" + tables.markdown(["sensor", "method", *MEASURES], lines)


def _profiles_table(rows: Sequence[Row], profiles: Sequence[str], timings: Mapping[str, Timing]) -> str:
    header = [
        "method", "beats Table I in ME and SD", "frames without contact", "phantoms", "deepest mm", "refused", "p50 ms",
    ]  # fmt: skip
    lines = []
    for profile in profiles:
        some = [r for r in rows if r.profile == profile]
        better, known = beats_table_i(by_object(some))
        nothing = null_figures(some)
        lines.append(
            [
                profile,
                f"{better} of {known}" if known else "",
                str(nothing.frames),
                str(nothing.phantoms),
                f"{nothing.deepest_mm:.2f}",
                str(nothing.refused),
                f"{timings[profile].p50_ms:.1f}" if profile in timings else "",
            ]
        )
    return "Profiles\n\n" + tables.markdown(header, lines)


def _cells(found: Figures) -> list[str]:
    values = (
        (found.me_mm, ".3f"),
        (found.backward_mm, ".3f"),
        (found.sd_pct, ".1f"),
        (found.sd_sum_pct, ".1f"),
        (found.iou, ".2f"),
        (found.depth_error_pct, ".0f"),
        (found.depth_error_worst_pct, ".0f"),
    )
    return [*("" if math.isnan(v) else format(v, spec) for v, spec in values), f"{found.missed}/{found.presses}"]


def _paper_cells(me_mm: float, sd_pct: float) -> list[str]:
    return [f"{me_mm:.3f}", "", f"{sd_pct:.1f}", "", "", "", "", ""]


def _mean_of_paper(known: Sequence[tuple[float, float]]) -> tuple[float, float]:
    return sum(me for me, _ in known) / len(known), sum(sd for _, sd in known) / len(known)


def _worst_of_paper(known: Sequence[tuple[float, float]]) -> tuple[float, float]:
    return max(me for me, _ in known), min(sd for _, sd in known)


def document(rows: Sequence[Row], timings: Mapping[str, Timing], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Everything except the rows, for JSON: settings, versions, Table I, and the summary of each profile."""
    summaries = {}
    for profile in dict.fromkeys(r.profile for r in rows):
        some = [r for r in rows if r.profile == profile]
        objects = by_object(some)
        paper = {k: v for k, v in objects.items() if k in PAPER_OBJECTS}
        better, known = beats_table_i(objects)
        summaries[profile] = {
            "paper_objects": _pair(some, paper),
            "other_objects": _pair(some, {k: v for k, v in objects.items() if k not in PAPER_OBJECTS}),
            "objects": {name: asdict(found) for name, found in objects.items()},
            "sensors": {s: asdict(figures(r for r in some if r.sensor == s)) for s in {r.sensor: 0 for r in some}},
            "without_contact": asdict(null_figures(some)),
            "beats_table_i": {"objects": better, "of": known},
            **({"timing": asdict(timings[profile])} if profile in timings else {}),
        }
    made: dict[str, Any] = without_nan(
        {
            "settings": dict(settings),
            "versions": versions(),
            "table_i": {name: {"me_mm": me, "sd_pct": sd} for name, (me, sd) in TABLE_I.items()},
            "profiles": summaries,
        }
    )
    return made


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that the figures depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def _pair(rows: Sequence[Row], objects: Mapping[str, Figures]) -> dict[str, Any] | None:
    if not objects:
        return None
    mean = figures(r for r in rows if r.object in objects)
    return {"mean": asdict(mean), "worst": asdict(worst(list(objects.values())))}


def without_nan(value: Any) -> Any:
    """Replace NaN by None, because JSON lacks NaN."""
    if isinstance(value, dict):
        return {key: without_nan(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    return None if isinstance(value, float) and math.isnan(value) else value
