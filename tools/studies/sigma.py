"""Whether the standard deviation of each height holds.

::

    .venv/bin/python -m tools.studies.sigma [--profile NAME...] [--sensors SEED,... | --final]
        [--objects NAME,...]
        [--references N] [--presses N] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedFrame, skin_points
from tacshade_edge.lab.studies.evaluate.work import SensorName, family_of, reconstructor
from tacshade_edge.lab.studies.markdown import grouped, summary
from tacshade_edge.sensor.depth.sigma import INTERVAL_90
from tacshade_edge.sensor.geometry.disc import Grid
from tacshade_edge.types import F32, F64, Bool, Calibration, Frame
from tools.studies import command, drag

NOISE = 7000
DRAGGED_MM = (0.0, 2.0)
"""Drags on a skin of 20 mm."""
COVERED = (85, 95)
"""Accepted coverage of 90 % intervals, %."""


@dataclass(frozen=True, slots=True)
class SigmaRow:
    """One frame in contact by one profile: as pressed on a skin of 20 mm;
    means over the cells found in contact.

    `covered` counts the cells whose 90 % interval holds the true height.
    """

    profile: str
    sensor: str
    object: str
    depth_mm: float
    drag_mm: float
    cells: int
    error_mm: float
    sigma_mm: float
    covered: int


@dataclass(frozen=True, slots=True, eq=False)
class Cells(SigmaRow):
    """A row, and |error| and σ in mm of each of its cells."""

    error_of_cells_mm: F32
    sigma_of_cells_mm: F32


def presses(
    model: SensorModel, seed: int | None, object_name: str
) -> Iterator[tuple[float, Press]]:
    """The presses of the study of drag, undragged and dragged by 2 mm, each with its drag in mm."""
    for condition, _, press in drag.presses(model, seed, object_name):
        if condition.drag_mm in DRAGGED_MM and not condition.twist_deg:
            yield condition.drag_mm, press


def true_height_mm(frame: SimulatedFrame, grid: Grid, where: Bool) -> F64:
    """The true h at some cells of a grid, float64 (N,)."""
    i, j = np.nonzero(where)
    row: F64 = grid.row0 + grid.step_px * i.astype(np.float64)
    col: F64 = grid.col0 + grid.step_px * j.astype(np.float64)
    points = skin_points(frame.skin, frame.model.geometry, row, col)
    return np.asarray(frame.skin.radius_mm - np.linalg.norm(points, axis=1))


def rows(profiles: Sequence[str], task: tuple[SensorName, Calibration, str]) -> list[Cells]:
    """Press and drag an object on a sensor."""
    name, calibration, object_name = task
    sensor = name.make()
    scale = sensor.model.skin_radius_mm / 20
    made = [reconstructor(calibration, profile) for profile in profiles]
    found = []
    for k, (drag_mm, press) in enumerate(presses(sensor.model, name.seed, object_name)):
        frame = sensor.frame((press,), NOISE + k)
        for each in made:
            result = each.step(Frame(0, 0, 0, frame.image))
            if not result.contact or result.sigma_mm is None:
                continue
            contact = result.height.contact
            error_mm = np.abs(
                result.height.height_mm[contact] - true_height_mm(frame, each.grid, contact)
            )
            sigma_mm = result.sigma_mm[contact]
            pressed = (
                result.profile,
                str(name),
                object_name,
                round(press.depth_mm / scale, 3),
                drag_mm,
            )
            covered = int(np.count_nonzero(error_mm <= INTERVAL_90 * sigma_mm))
            means = (len(sigma_mm), float(error_mm.mean()), float(sigma_mm.mean()), covered)
            found.append(Cells(*pressed, *means, error_mm.astype(np.float32), sigma_mm))
    return found


def joined(found: Sequence[Cells]) -> tuple[F32, F32]:
    """|error| and σ of all cells in mm."""
    errors, sigmas = (
        [each.error_of_cells_mm for each in found],
        [each.sigma_of_cells_mm for each in found],
    )
    return np.concatenate(errors), np.concatenate(sigmas)


def covered_pct(found: Sequence[Cells]) -> float:
    """Share of the cells whose 90 % interval holds the true height."""
    return 100 * sum(each.covered for each in found) / sum(each.cells for each in found)


def _part_of_tenth(found: Sequence[Cells], of: int) -> str:
    """Share of all absolute error in the tenth of the cells with the greatest error (0) or σ
    (1).
    """
    cells = joined(found)
    count = max(1, len(cells[0]) // 10)
    greatest = np.argpartition(-cells[of], count - 1)[:count]
    error_mm = cells[0]
    whole_mm = max(error_mm.sum(dtype=np.float64), 1e-12)
    return f"{100 * error_mm[greatest].sum(dtype=np.float64) / whole_mm:.1f}"


FIGURES: dict[str, Callable[[Sequence[Cells]], str]] = {
    "frames": lambda some: str(len(some)),
    "cells": lambda some: str(sum(each.cells for each in some)),
    "error mm": lambda some: f"{joined(some)[0].mean(dtype=np.float64):.3f}",
    "σ mm": lambda some: f"{joined(some)[1].mean(dtype=np.float64):.3f}",
    "in the 90 % interval %": lambda some: f"{covered_pct(some):.1f}",
    "error in the tenth of greatest σ %": lambda some: _part_of_tenth(some, 1),
    "of greatest error %": lambda some: _part_of_tenth(some, 0),
}


def text(found: Sequence[Cells]) -> str:
    """A table for each family of sensors and one for both, lines for each profile,
    depth and drag.
    """
    families = {
        f"Family {name}": of
        for name, of in grouped(found, lambda row: family_of(row.sensor)).items()
    }
    tables = []
    for title, mine in (families | ({"Both families": found} if len(families) > 1 else {})).items():
        groups: list[tuple[tuple[str, str], Sequence[Cells]]] = []
        for profile, of in grouped(mine, "profile").items():
            for what, by in (("mm deep", "depth_mm"), ("mm of drag", "drag_mm")):
                groups += [
                    ((f"{mm:g} {what}", profile), some)
                    for mm, some in sorted(grouped(of, by).items())
                ]
            groups.append((("all", profile), of))
        tables.append(f"{title}\n\n{summary(('what', 'method'), groups, FIGURES)}")
    return "\n\n".join(tables)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Whether the standard deviation of each height holds.", drag.SENSORS)
    command.add_calibration(parser)
    args = parser.parse_args(words)
    command.check_presses(parser, args.presses)
    if "paper" in args.profile:
        parser.error("--profile: found paper, which gives no errors")
    work = partial(
        command.over_sensors,
        partial(rows, args.profile),
        args.sensors,
        args.objects,
        fitted=args.fitted,
    )
    work = partial(work, references=args.references, presses=args.presses)
    command.run(parser, args, "sigma", work, text, {"": SigmaRow})


if __name__ == "__main__":
    main()
