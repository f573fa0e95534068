"""Rows to the figures that are quoted, and the figures to tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.studies.tables import markdown
from tools.studies.drag.work import DragRow

TELLING_MM = 0.5
"""Least true shear at which its direction counts, mm."""
WRONG, WRONG_MM = 0.25, 0.3
"""Errors, as a ratio and in mm, beyond which a depth is wrong."""


@dataclass(frozen=True, slots=True)
class DragFigures:
    """Of some rows of one profile; a missed contact counts as its true depth, with SD 0.

    `silent` counts the `silently_wrong`; the other names are those of the table.
    """

    frames: int
    refused: int
    missed: int
    me_mm: float
    sd_pct: float
    iou: float
    silent: int
    shear_median_mm: float
    shear_95_mm: float
    within: float
    direction_95_deg: float
    twist_95_deg: float


def figures(rows: Sequence[DragRow]) -> DragFigures:
    """Summarise rows: at least one."""
    me = [row.true_depth_mm if math.isnan(row.me_mm) else row.me_mm for row in rows]
    true, found = (
        np.array([(getattr(row, f"{which}_shear_x_mm"), getattr(row, f"{which}_shear_y_mm")) for row in rows])
        for which in ("true", "found")
    )
    there = np.isfinite(found).all(axis=1)
    off, size = np.linalg.norm(found - true, axis=1)[there], np.linalg.norm(true, axis=1)[there]
    turned = np.degrees(
        np.arctan2(
            true[:, 0] * found[:, 1] - true[:, 1] * found[:, 0], true[:, 0] * found[:, 0] + true[:, 1] * found[:, 1]
        )
    )[there][size > TELLING_MM]
    twisted = np.array([row.found_twist_deg - row.true_twist_deg for row in rows])
    return DragFigures(
        frames=len(rows),
        refused=sum(bool(row.refused) for row in rows),
        missed=sum(not row.refused and not row.contact for row in rows),
        me_mm=float(np.mean(me)),
        sd_pct=float(np.mean([row.sd_pct for row in rows])),
        iou=float(np.mean([row.iou for row in rows])),
        silent=sum(map(silently_wrong, rows)),
        shear_median_mm=_quantile(off, 0.5),
        shear_95_mm=_quantile(off, 0.95),
        within=float(np.mean(off <= np.maximum(0.35, 0.1 * size))) if len(off) else math.nan,
        direction_95_deg=_quantile(np.abs(turned), 0.95),
        twist_95_deg=_quantile(np.abs(twisted[np.isfinite(twisted)]), 0.95),
    )


def silently_wrong(row: DragRow) -> bool:
    """Whether the greatest depth is wrong by a quarter and 0.3 mm, and nothing says so."""
    off_mm = abs(row.found_depth_mm - row.true_depth_mm)
    told = bool(row.refused) or row.saturated or row.degraded
    return off_mm > max(WRONG * row.true_depth_mm, WRONG_MM) and not told


def text(rows: Sequence[DragRow]) -> str:
    """A table for each family of sensors, a line for each condition and profile."""
    tables = []
    for family in dict.fromkeys(family_of(row) for row in rows):
        mine = [row for row in rows if family_of(row) == family]
        lines = []
        for profile in dict.fromkeys(row.profile for row in mine):
            for condition in (*dict.fromkeys(row.condition for row in mine), None):
                some = [r for r in mine if r.profile == profile and condition in (r.condition, None)]
                lines.append((condition or "all", profile, *_cells(figures(some))))
        tables.append(f"Family {family}\n\n{markdown(HEADER, lines)}")
    return "\n\n".join(tables)


HEADER = (
    "what", "method", "frames", "refused", "missed", "ME mm", "SD %", "IoU", "silently wrong",
    "shear off mm: median", "95 %", "within 0.35 mm or a tenth %", "direction off °: 95 %", "twist off °: 95 %",
)  # fmt: skip


def family_of(row: DragRow) -> str:
    """The family of a row's sensor."""
    return row.sensor.rpartition(":")[0] or "tacshade"


def _cells(of: DragFigures) -> tuple[str, ...]:
    return (
        str(of.frames), str(of.refused), str(of.missed), f"{of.me_mm:.3f}", f"{of.sd_pct:.1f}", f"{of.iou:.2f}",
        str(of.silent),
        f"{of.shear_median_mm:.2f}", f"{of.shear_95_mm:.2f}", f"{100 * of.within:.0f}", f"{of.direction_95_deg:.0f}",
        f"{of.twist_95_deg:.1f}",
    )  # fmt: skip


def _quantile(values: np.typing.NDArray[np.float64], part: float) -> float:
    return float(np.quantile(values, part)) if len(values) else math.nan
