"""Summarise rows to the quoted figures: means over an object's presses, the worst object, Table I of the paper."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.studies.evaluate.score import Row

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
    """Means over presses. A missed contact (an empty cloud) counts as undeformed skin: SD is 0, and ME and the backward
    distance are the true depth.

    Attributes
    ----------
    presses, missed : int
    me_mm, backward_mm, sd_pct, sd_sum_pct, iou : float
        NaN if nothing is known.
    depth_error_pct, depth_error_worst_pct : float
        Mean and greatest absolute error of the greatest depth.
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
    grouped: dict[str, list[Row]] = {}
    for row in rows:
        if row.true_points:
            grouped.setdefault(row.object, []).append(row)
    return {name: figures(some) for name, some in grouped.items()}


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
