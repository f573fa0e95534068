"""Cells to the figures that are quoted: how many intervals hold, and how much of the error the widest tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F32
from tools.studies.sigma.work import Found


@dataclass(frozen=True, slots=True)
class SigmaFigures:
    """Of some frames by one profile, over all cells of their contacts.

    Attributes
    ----------
    frames, cells : int
    error_mm, sigma_mm : float
        Means.
    covered : float
        Part of the cells whose 90 % interval holds the true height.
    told : float
        Share of all absolute error in the tenth of the cells with the greatest σ.
    most : float
        The same share in the tenth with the greatest error.
    """

    frames: int
    cells: int
    error_mm: float
    sigma_mm: float
    covered: float
    told: float
    most: float


def figures(found: Sequence[Found]) -> SigmaFigures:
    """Summarise frames: at least one."""
    error_mm, sigma_mm = joined(found)
    return SigmaFigures(
        frames=len(found),
        cells=len(error_mm),
        error_mm=float(error_mm.mean(dtype=np.float64)),
        sigma_mm=float(sigma_mm.mean(dtype=np.float64)),
        covered=sum(each.row.covered for each in found) / len(error_mm),
        told=_part_of_tenth(error_mm, sigma_mm),
        most=_part_of_tenth(error_mm, error_mm),
    )


def joined(found: Sequence[Found]) -> tuple[F32, F32]:
    """|error| and σ of all cells in mm."""
    return np.concatenate([each.error_mm for each in found]), np.concatenate([each.sigma_mm for each in found])


def _part_of_tenth(error_mm: F32, by: F32) -> float:
    count = max(1, len(error_mm) // 10)
    greatest = np.argpartition(-by, count - 1)[:count]
    return float(error_mm[greatest].sum(dtype=np.float64) / max(error_mm.sum(dtype=np.float64), 1e-12))


def text(found: Sequence[Found]) -> str:
    """A table for each family of sensors and one for both, lines for each profile, depth and drag."""
    families = list(dict.fromkeys(map(family_of, found)))
    tables = []
    for family in (*families, *([None] if len(families) > 1 else [])):
        mine = [each for each in found if family in (family_of(each), None)]
        lines = []
        for profile in dict.fromkeys(each.row.profile for each in mine):
            of = [each for each in mine if each.row.profile == profile]
            lines += [(what, profile, *_cells(figures(some))) for what, some in _groups(of).items()]
        tables.append(f"{f'Family {family}' if family else 'Both families'}\n\n{markdown(HEADER, lines)}")
    return "\n\n".join(tables)


HEADER = (
    "what", "method", "frames", "cells", "error mm", "σ mm", "in the 90 % interval %",
    "error in the tenth of greatest σ %", "of greatest error %",
)  # fmt: skip


def family_of(found: Found) -> str:
    """The family of a row's sensor."""
    return found.row.sensor.rpartition(":")[0] or "tacshade"


def _groups(found: Sequence[Found]) -> dict[str, list[Found]]:
    """By depth, by drag, all."""
    groups: dict[str, list[Found]] = {}
    for each in sorted(found, key=lambda each: each.row.depth_mm):
        groups.setdefault(f"{each.row.depth_mm:g} mm deep", []).append(each)
    for each in sorted(found, key=lambda each: each.row.drag_mm):
        groups.setdefault(f"{each.row.drag_mm:g} mm of drag", []).append(each)
    return groups | {"all": list(found)}


def _cells(of: SigmaFigures) -> tuple[str, ...]:
    return (
        str(of.frames), str(of.cells), f"{of.error_mm:.3f}", f"{of.sigma_mm:.3f}", f"{100 * of.covered:.1f}",
        f"{100 * of.told:.1f}", f"{100 * of.most:.1f}",
    )  # fmt: skip
