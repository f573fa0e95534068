"""Summarise the rows of an evaluation to the quoted figures; format them for people (tables) and programs (JSON)."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from typing import Any

import numpy as np

from tacshade_edge.simulator.press import PAPER_OBJECTS
from tacshade_edge.studies import tables
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.work import Timing, family_of

TABLE_I = {
    "cube": (0.9120, 78.63),
    "small_crescent": (0.5008, 85.33),
    "ball": (0.1039, 96.02),
    "large_crescent": (0.7849, 77.84),
    "cylinder": (0.8934, 72.49),
}
"""The paper's ME in mm and SD in %, measured on a real sensor."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Means over presses, NaN if nothing is known; depth errors are the mean and the greatest absolute error.

    A missed contact (an empty cloud) counts as undeformed skin: SD is 0, and ME and the backward distance are the true
    depth.
    """

    presses: int
    missed: int
    me_mm: float
    backward_mm: float
    sd_pct: float
    sd_sum_pct: float
    iou: float
    depth_error_pct: float
    depth_error_worst_pct: float


@dataclass(frozen=True, slots=True)
class NullFigures:
    """Figures of the frames without contact: phantoms, the greatest depth of one, and refused frames."""

    frames: int
    phantoms: int
    deepest_mm: float
    refused: int


def figures(rows: Iterable[Row]) -> Figures:
    """Means over the rows with a true contact."""
    some = [r for r in rows if r.true_points]
    off = np.array([abs(r.depth_error_pct) for r in some])
    missed = [math.isnan(r.me_mm) for r in some]
    return Figures(
        presses=len(some),
        missed=sum(missed),
        me_mm=_mean(r.true_depth_mm if m else r.me_mm for r, m in zip(some, missed, strict=True)),
        backward_mm=_mean(r.true_depth_mm if m else r.backward_mm for r, m in zip(some, missed, strict=True)),
        sd_pct=_mean(r.sd_pct for r in some),
        sd_sum_pct=_mean(r.sd_sum_pct for r in some),
        iou=_mean(r.iou for r in some if not math.isnan(r.iou)),
        depth_error_pct=_mean(off),
        depth_error_worst_pct=float(off.max()) if some else math.nan,
    )


def by_object(rows: Iterable[Row]) -> dict[str, Figures]:
    """Figures of each object, in the order of the rows."""
    return {name: figures(some) for name, some in tables.grouped((r for r in rows if r.true_points), "object").items()}


def worst(objects: Sequence[Figures]) -> Figures:
    """The worst object's mean of each measure: the greatest error, the smallest SD and IoU."""
    chosen: dict[str, float] = {}
    for field in fields(Figures):
        values = [v for each in objects if not math.isnan(v := getattr(each, field.name))]
        pick = min if field.name in ("presses", "sd_pct", "sd_sum_pct", "iou") else max
        chosen[field.name] = pick(values) if values else math.nan
    return Figures(**chosen)  # type: ignore[arg-type]  # presses and missed stay whole numbers


def null_figures(rows: Iterable[Row]) -> NullFigures:
    """Count phantoms over rows without true contact."""
    some = [r for r in rows if not r.true_points]
    return NullFigures(
        frames=len(some),
        phantoms=sum(r.contact for r in some),
        deepest_mm=max((r.found_depth_mm for r in some), default=0.0),
        refused=sum(not r.valid for r in some),
    )


def beats_table_i(objects: dict[str, Figures]) -> tuple[int, int]:
    """The number of Table I's objects on which both measures beat the paper's, and the number that were evaluated."""
    known = [name for name in PAPER_OBJECTS if name in objects]
    better = [
        name for name in known if objects[name].me_mm < TABLE_I[name][0] and objects[name].sd_pct > TABLE_I[name][1]
    ]
    return len(better), len(known)


def _mean(values: Iterable[float]) -> float:
    some = list(values)
    return float(np.mean(some)) if some else math.nan


PACKAGES = ("tacshade-edge", "numpy", "opencv-contrib-python-headless", "onnxruntime", "scipy")
MEASURES = {
    "ME mm": ("me_mm", ".3f"),
    "back mm": ("backward_mm", ".3f"),
    "SD %": ("sd_pct", ".1f"),
    "SD sum %": ("sd_sum_pct", ".1f"),
    "IoU": ("iou", ".2f"),
    "depth off %": ("depth_error_pct", ".0f"),
    "worst %": ("depth_error_worst_pct", ".0f"),
}
"""Columns of a table: an attribute of `Figures`, and its format."""
PAPER_ROW = "Table I (real sensor)"


def table(rows: Sequence[Row], timings: Mapping[str, Timing]) -> str:
    """Markdown tables, readable as plain text too: objects, sensors and profiles, separately for each family."""
    families = tables.grouped(rows, lambda row: family_of(row.sensor))
    if len(families) < 2:
        return _family_table(rows, timings)
    return "\n\n".join(f"Family {family}\n\n{_family_table(some, timings)}" for family, some in families.items())


def _family_table(rows: Sequence[Row], timings: Mapping[str, Timing]) -> str:
    profiles = tables.grouped(rows, "profile")
    objects = list(dict.fromkeys(r.object for r in rows if r.true_points))
    blocks = (
        ("The paper's five objects", [o for o in objects if o in PAPER_OBJECTS]),
        ("Other objects", [o for o in objects if o not in PAPER_OBJECTS]),
    )
    parts = [_objects_table(title, profiles, names) for title, names in blocks if names]
    if objects:
        lines = [
            [sensor, profile, *_cells(figures(r for r in of_sensor if r.profile == profile))]
            for sensor, of_sensor in tables.grouped(rows, "sensor").items()
            for profile in profiles
        ]
        parts.append(f"Each sensor, all objects\n\n{tables.markdown(['sensor', 'method', *MEASURES, 'missed'], lines)}")
    parts.append(_profiles_table(profiles, timings))
    return "\n\n".join(parts)


def _objects_table(title: str, profiles: Mapping[str, Sequence[Row]], names: Sequence[str]) -> str:
    some = {profile: [r for r in rows if r.object in names] for profile, rows in profiles.items()}
    found = {profile: by_object(rows) for profile, rows in some.items()}
    paper = {name: TABLE_I[name] for name in names if name in TABLE_I}
    lines = []
    for name in names:
        if name in paper:
            lines.append([name, PAPER_ROW, *_paper_cells(*paper[name])])
        lines += [[name, profile, *_cells(objects[name])] for profile, objects in found.items()]
    if len(names) > 1:
        me_mm, sd_pct = zip(*paper.values(), strict=True) if paper else ((math.nan,), (math.nan,))
        of_paper = {"mean": (_mean(me_mm), _mean(sd_pct)), "worst object": (max(me_mm), min(sd_pct))}
        for what, values in of_paper.items():
            if len(paper) == len(names):
                lines.append([what, PAPER_ROW, *_paper_cells(*values)])
            for profile, objects in found.items():
                total = figures(some[profile]) if what == "mean" else worst(list(objects.values()))
                lines.append([what, profile, *_cells(total)])
    return f"{title}\n\n" + tables.markdown(["object", "method", *MEASURES, "missed"], lines)


def _profiles_table(profiles: Mapping[str, Sequence[Row]], timings: Mapping[str, Timing]) -> str:
    header = [
        "method", "beats Table I in ME and SD", "frames without contact", "phantoms", "deepest mm", "refused", "p50 ms",
    ]  # fmt: skip
    lines = []
    for profile, some in profiles.items():
        better, known = beats_table_i(by_object(some))
        nothing = null_figures(some)
        beats = f"{better} of {known}" if known else ""
        p50 = f"{timings[profile].p50_ms:.1f}" if profile in timings else ""
        refused = sum(not row.valid for row in some)  # with and without contact
        counts = (str(nothing.frames), str(nothing.phantoms), f"{nothing.deepest_mm:.2f}", str(refused))
        lines.append([profile, beats, *counts, p50])
    return "Profiles\n\n" + tables.markdown(header, lines)


def _cells(found: Figures) -> list[str]:
    measured = (tables.number(getattr(found, name), spec) for name, spec in MEASURES.values())
    return [*measured, f"{found.missed}/{found.presses}"]


def _paper_cells(me_mm: float, sd_pct: float) -> list[str]:
    return [f"{me_mm:.3f}", "", f"{sd_pct:.1f}", "", "", "", "", ""]


def document(rows: Sequence[Row], timings: Mapping[str, Timing], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Everything except the rows, for JSON: settings, versions, Table I, and the summary of each profile."""
    summaries = {}
    for profile, some in tables.grouped(rows, "profile").items():
        objects = by_object(some)
        paper = {k: v for k, v in objects.items() if k in PAPER_OBJECTS}
        better, known = beats_table_i(objects)
        summaries[profile] = {
            "paper_objects": _pair(some, paper),
            "other_objects": _pair(some, {k: v for k, v in objects.items() if k not in PAPER_OBJECTS}),
            "objects": {name: asdict(found) for name, found in objects.items()},
            "sensors": {s: asdict(figures(of)) for s, of in tables.grouped(some, "sensor").items()},
            "without_contact": asdict(null_figures(some)),
            "beats_table_i": {"objects": better, "of": known},
            **({"timing": asdict(timings[profile])} if profile in timings else {}),
        }
    made: dict[str, Any] = tables.without_nan(
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
