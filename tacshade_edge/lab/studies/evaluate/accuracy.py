"""Summarise the rows of an evaluation to the quoted figures;
format them for people (tables) and programs (JSON).
"""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.studies import markdown
from tacshade_edge.lab.studies.evaluate.score import Row
from tacshade_edge.lab.studies.evaluate.work import family_of

TABLE_I = {
    "cube": (0.9120, 78.63),
    "small_crescent": (0.5008, 85.33),
    "ball": (0.1039, 96.02),
    "large_crescent": (0.7849, 77.84),
    "cylinder": (0.8934, 72.49),
}
"""The paper's ME in mm and SD in %, measured on a real sensor."""
PAPER_ROW = "Table I (real sensor)"
PACKAGES = ("tacshade-edge", "numpy", "opencv-contrib-python-headless", "onnxruntime", "scipy")
MEASURES = {
    "ME mm": ("me_mm", ".3f"),
    "SD %": ("sd_pct", ".1f"),
    "depth off %": ("depth_error_pct", ".0f"),
}
"""Columns of a table: an attribute of `Figures`, and its format."""
COUNTS = ("found", "touched", "missed")
"""Columns of numbers of presses, which are all of them."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Means over presses, NaN if nothing is known; the depth error is the mean absolute one.

    Presses are found, `touched` (their depth is unknown) or missed. Where none was found, the cloud
    is empty and counts as undeformed skin: SD is 0, and ME and the backward distance are the true
    depth.
    """

    presses: int
    found: int
    touched: int
    missed: int
    me_mm: float
    backward_mm: float
    sd_pct: float
    sd_sum_pct: float
    iou: float
    depth_error_pct: float


@dataclass(frozen=True, slots=True)
class NullFigures:
    """Figures of the frames without contact: phantoms, `touched` frames, the greatest depth,
    and refused frames.
    """

    frames: int
    phantoms: int
    touched: int
    deepest_mm: float
    refused: int


def figures(rows: Iterable[Row]) -> Figures:
    """Means over the rows with a true contact."""
    # Frames without contact have no errors: they are counted in `null_figures`.
    some = [r for r in rows if r.true_points]
    empty, touched = sum(math.isnan(r.me_mm) for r in some), sum(r.touched for r in some)

    def mean_mm(name: str) -> float:
        found = [(r, getattr(r, name)) for r in some]
        # What was missed counts: a method that finds only easy presses would otherwise win.
        return _mean(r.true_depth_mm if math.isnan(mm) else mm for r, mm in found)

    return Figures(
        presses=len(some),
        found=len(some) - empty,
        touched=touched,
        missed=empty - touched,
        me_mm=mean_mm("me_mm"),
        backward_mm=mean_mm("backward_mm"),
        sd_pct=_mean(r.sd_pct for r in some),
        sd_sum_pct=_mean(r.sd_sum_pct for r in some),
        # An own truth may have points and no map of the contact.
        iou=_mean(r.iou for r in some if not math.isnan(r.iou)),
        # A depth that is not known is wrong by all of it.
        depth_error_pct=_mean(100.0 if r.touched else abs(r.depth_error_pct) for r in some),
    )


def null_figures(rows: Iterable[Row]) -> NullFigures:
    """Count phantoms and touched frames over rows without true contact."""
    some = [r for r in rows if not r.true_points]
    return NullFigures(
        frames=len(some),
        phantoms=sum(r.contact for r in some),
        touched=sum(r.touched for r in some),
        # Touched frames state no depth.
        deepest_mm=max((r.found_depth_mm for r in some if not r.touched), default=0.0),
        refused=sum(not r.valid for r in some),
    )


def _mean(values: Iterable[float]) -> float:
    some = list(values)
    return float(np.mean(some)) if some else math.nan


def table(rows: Sequence[Row]) -> str:
    """Markdown tables, readable as plain text too:
    objects and profiles, separately for each family.
    """
    families = markdown.grouped(rows, lambda row: family_of(row.sensor))
    if len(families) <= 1:
        return _family_table(rows)
    return "\n\n".join(
        f"Family {family}\n\n{_family_table(some)}" for family, some in families.items()
    )


def _family_table(rows: Sequence[Row]) -> str:
    profiles = markdown.grouped(rows, "profile")
    # In the order of the rows, which is that of the command.
    objects = list(dict.fromkeys(r.object for r in rows if r.true_points))
    blocks = (
        ("The paper's five objects", [o for o in objects if o in PAPER_OBJECTS]),
        ("Other objects", [o for o in objects if o not in PAPER_OBJECTS]),
    )
    parts = [_objects_table(title, profiles, names) for title, names in blocks if names]
    nothing = {profile: null_figures(some) for profile, some in profiles.items()}
    lines = [
        [
            profile,
            str(of.frames),
            str(of.phantoms),
            str(of.touched),
            f"{of.deepest_mm:.2f}",
            str(sum(not r.valid for r in some)),
        ]
        for (profile, some), of in zip(profiles.items(), nothing.values(), strict=True)
    ]
    header = ["method", "frames without contact", "phantoms", "touched", "deepest mm", "refused"]
    return "\n\n".join([*parts, "Profiles\n\n" + markdown.markdown(header, lines)])


def _objects_table(title: str, profiles: Mapping[str, Sequence[Row]], names: Sequence[str]) -> str:
    paper = {name: TABLE_I[name] for name in names if name in TABLE_I}
    # A mean beside ours only if it is of the same objects.
    if len(paper) == len(names) > 1:
        paper["mean"] = (
            _mean(me for me, _ in paper.values()),
            _mean(sd for _, sd in paper.values()),
        )
    lines = []
    for name in (*names, *(["mean"] if len(names) > 1 else [])):
        if name in paper:
            me_mm, sd_pct = paper[name]
            lines.append([name, PAPER_ROW, f"{me_mm:.3f}", f"{sd_pct:.1f}", *("",) * 4])
        for profile, rows in profiles.items():
            found = figures(r for r in rows if r.object in (names if name == "mean" else (name,)))
            measured = (
                markdown.number(getattr(found, measure), spec)
                for measure, spec in MEASURES.values()
            )
            lines.append([name, profile, *measured, *(str(getattr(found, one)) for one in COUNTS)])
    return f"{title}\n\n" + markdown.markdown(["object", "method", *MEASURES, *COUNTS], lines)


def document(rows: Sequence[Row], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Everything except the rows, for JSON: settings, versions, Table I,
    and the summary of each profile.
    """
    summaries = {
        profile: {
            "all": asdict(figures(some)),
            "objects": {
                name: asdict(figures(of))
                for name, of in markdown.grouped(
                    (r for r in some if r.true_points), "object"
                ).items()
            },
            "sensors": {
                name: asdict(figures(of)) for name, of in markdown.grouped(some, "sensor").items()
            },
            "without_contact": asdict(null_figures(some)),
        }
        for profile, some in markdown.grouped(rows, "profile").items()
    }
    made: dict[str, Any] = markdown.without_nan(
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
