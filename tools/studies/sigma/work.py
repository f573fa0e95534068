"""The jobs of the study: objects pressed and dragged, and at every cell of a contact the error and its σ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.depth.sigma import INTERVAL_90
from tacshade_edge.core.geometry.disc import Grid
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.truth import skin_points
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName, calibrate_sensors, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import F32, F64, Bool, Calibration, Frame, freeze
from tools.studies.drag.work import CONDITIONS
from tools.studies.drag.work import presses as drag_presses

NOISE = 7000
DRAGGED_MM = (0.0, 2.0)
"""Drags on a skin of 20 mm."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The extent of a study; equal plans give equal rows."""

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    objects: tuple[str, ...] = tuple(OBJECTS)
    references: int = REFERENCES
    presses: int = PRESSES


@dataclass(frozen=True, slots=True)
class SigmaRow:
    """One frame in contact by one profile; a column of sigma.csv each.

    Attributes
    ----------
    profile, sensor, object : str
    depth_mm, drag_mm : float
        As pressed, on a skin of 20 mm.
    cells : int
        In contact, as found.
    error_mm, sigma_mm : float
        Mean over them.
    covered : int
        Those whose 90 % interval holds the true height.
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
class Found:
    """A row, and |error| and σ in mm of each of its cells, float32 (cells,)."""

    row: SigmaRow
    error_mm: F32
    sigma_mm: F32

    def __post_init__(self) -> None:
        freeze(self, "error_mm", "sigma_mm")


def study(plan: Plan, workers: Workers, report: Report) -> tuple[Found, ...]:
    """Run a plan. Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed)."""
    made = calibrate_sensors(plan.sensors, plan.references, plan.presses, workers, report)
    known = [(plan, name, each.calibration) for name, each in zip(plan.sensors, made, strict=True)]
    tasks = [(*each, what) for each in known for what in plan.objects]
    return tuple(each for some in reported_map(_found, tasks, workers, report, "objects pressed") for each in some)


def presses(model: SensorModel, seed: int | None, object_name: str) -> Iterator[tuple[float, Press]]:
    """The presses of the study of drag, undragged and dragged by 2 mm, each with its drag in mm."""
    wanted = [each for each in CONDITIONS if each.drag_mm in DRAGGED_MM and not each.twist_deg]
    for condition, _, press in drag_presses(model, seed, object_name):
        if condition in wanted:
            yield condition.drag_mm, press


def true_height_mm(frame: SimulatedFrame, grid: Grid, where: Bool) -> F64:
    """The true h at some cells of a grid, float64 (N,)."""
    i, j = np.nonzero(where)
    row: F64 = grid.row0 + grid.step_px * i.astype(np.float64)
    col: F64 = grid.col0 + grid.step_px * j.astype(np.float64)
    points = skin_points(frame.skin, frame.model.geometry, row, col)
    return np.asarray(frame.skin.radius_mm - np.linalg.norm(points, axis=1))


def _found(task: tuple[Plan, SensorName, Calibration, str]) -> list[Found]:
    plan, name, calibration, object_name = task
    sensor = name.make()
    scale = sensor.model.skin_radius_mm / 20
    made = [reconstructor(calibration, profile) for profile in plan.profiles]
    found = []
    for k, (drag_mm, press) in enumerate(presses(sensor.model, name.seed, object_name)):
        frame = sensor.frame((press,), NOISE + k)
        for each in made:
            result = each.step(Frame(0, 0, 0, frame.image))
            if not result.contact or result.sigma_mm is None:
                continue
            contact = result.height.contact
            error_mm = np.abs(result.height.height_mm[contact] - true_height_mm(frame, each.grid, contact))
            sigma_mm = result.sigma_mm[contact]
            row = SigmaRow(
                profile=result.profile,
                sensor=str(name),
                object=object_name,
                depth_mm=round(press.depth_mm / scale, 3),
                drag_mm=drag_mm,
                cells=len(sigma_mm),
                error_mm=float(error_mm.mean()),
                sigma_mm=float(sigma_mm.mean()),
                covered=int(np.count_nonzero(error_mm <= INTERVAL_90 * sigma_mm)),
            )
            found.append(Found(row, error_mm.astype(np.float32), sigma_mm))
    return found
