"""The jobs of the study: objects that are pressed, tilted, dragged and turned on calibrated sensors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tacshade_edge.core.contact.rigid_motion import about_mean, rigid_motions
from tacshade_edge.reasons import code_of
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.truth import Truth
from tacshade_edge.studies.evaluate.score import KnownTruth, Label, score
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName, calibrate_sensors, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import Calibration, Frame, Reconstruction

SENSORS = "default,5,other:31,other:32"
"""The study's default sensors."""
DIRECTIONS = 4
DEPTHS_MM = (1.0, 2.75, 4.5)
FARTHEST = 0.3
"""Greatest distance of a place from the tip, in skin radii."""
NOISE = 6000
_TRUE_POINTS = 4000
"""Number of a contact's points that give the skin's true motion."""


@dataclass(frozen=True, slots=True)
class Condition:
    """What is done to an object in addition to pressing it; lengths on a skin of 20 mm."""

    drag_mm: float = 0.0
    twist_deg: float = 0.0
    tilt_deg: float = 0.0

    def __str__(self) -> str:
        """For a table."""
        beside = [f"twist {self.twist_deg:g}°"] * bool(self.twist_deg) + [f"tilt {self.tilt_deg:g}°"] * bool(
            self.tilt_deg
        )
        return ", ".join((f"{self.drag_mm:g} mm", *beside))


CONDITIONS = (Condition(), Condition(1.0), Condition(2.0), Condition(3.0), Condition(3.0, 10.0, 15.0))


@dataclass(frozen=True, slots=True)
class Plan:
    """The extent of a study; equal plans give equal rows."""

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    objects: tuple[str, ...] = tuple(OBJECTS)
    references: int = REFERENCES
    presses: int = PRESSES


@dataclass(frozen=True, slots=True)
class DragRow:
    """One frame by one profile; a column of drag.csv each, empty where it is NaN.

    Attributes
    ----------
    profile, sensor, object, condition : str
    depth_mm, drag_mm, direction_deg, twist_deg, tilt_deg : float
        As pressed, in mm of this sensor.
    refused : str
        Code of the reason.
    contact, saturated, degraded : bool
    true_depth_mm, found_depth_mm : float
    me_mm, backward_mm, sd_pct, iou : float
        Of `studies.evaluate.score`.
    true_shear_x_mm, true_shear_y_mm, found_shear_x_mm, found_shear_y_mm : float
        Mean over the contact.
    true_twist_deg, found_twist_deg : float
    """

    profile: str
    sensor: str
    object: str
    condition: str
    depth_mm: float
    drag_mm: float
    direction_deg: float
    twist_deg: float
    tilt_deg: float
    refused: str
    contact: bool
    saturated: bool
    degraded: bool
    true_depth_mm: float
    found_depth_mm: float
    me_mm: float
    backward_mm: float
    sd_pct: float
    iou: float
    true_shear_x_mm: float
    true_shear_y_mm: float
    found_shear_x_mm: float
    found_shear_y_mm: float
    true_twist_deg: float
    found_twist_deg: float


def study(plan: Plan, workers: Workers, report: Report) -> tuple[DragRow, ...]:
    """Run a plan. Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed)."""
    found = calibrate_sensors(plan.sensors, plan.references, plan.presses, workers, report)
    known = [(plan, name, made.calibration) for name, made in zip(plan.sensors, found, strict=True)]
    tasks = [(*each, what) for each in known for what in plan.objects]
    return tuple(chain.from_iterable(reported_map(_rows, tasks, workers, report, "objects dragged")))


def presses(model: SensorModel, seed: int | None, object_name: str) -> Iterator[tuple[Condition, float, Press]]:
    """Every condition, direction in degrees and depth of an object; the same places and tilts for every condition."""
    scale, shape = model.skin_radius_mm / 20, OBJECTS[object_name]()
    for condition in CONDITIONS:
        rng = np.random.default_rng((0 if seed is None else seed + 1, 31, list(OBJECTS).index(object_name)))
        for k in range(DIRECTIONS):
            rho, angle, turn, lean = rng.uniform(
                (0, 0, 0, 0), (FARTHEST * model.skin_radius_mm, 2 * math.pi, 360, 2 * math.pi)
            )
            direction = 360 * (k + rng.uniform()) / DIRECTIONS
            along = math.radians(direction)
            for depth_mm in DEPTHS_MM:
                yield (
                    condition,
                    direction,
                    Press(
                        shape,
                        rho * math.cos(angle),
                        rho * math.sin(angle),
                        depth_mm * scale,
                        turn,
                        scale,
                        condition.tilt_deg * math.cos(lean),
                        condition.tilt_deg * math.sin(lean),
                        condition.drag_mm * scale * math.cos(along),
                        condition.drag_mm * scale * math.sin(along),
                        condition.twist_deg * (1 if k % 2 else -1),
                    ),
                )


def _rows(task: tuple[Plan, SensorName, Calibration, str]) -> list[DragRow]:
    plan, name, calibration, object_name = task
    sensor = name.make()
    made = [reconstructor(calibration, profile) for profile in plan.profiles]
    rows = []
    for k, (condition, direction, press) in enumerate(presses(sensor.model, name.seed, object_name)):
        frame = sensor.frame((press,), NOISE + k)
        truth = frame.truth()
        if not len(truth.points_mm):
            continue
        motion = _motion(frame, truth)
        for each in made:
            result = each.step(Frame(0, 0, 0, frame.image))
            rows.append(_row(str(name), object_name, condition, direction, press, truth, motion, result))
    return rows


def _motion(frame: SimulatedFrame, truth: Truth) -> tuple[float, float, float]:
    """Mean shear and twist of the skin that truly touches."""
    rows, cols = np.nonzero(truth.contact)
    some = slice(None, None, -(-len(rows) // _TRUE_POINTS))
    shear = frame.shear_mm(rows[some].astype(float), cols[some].astype(float)).T
    one, count = np.array([0]), np.array([shear.shape[1]])
    points = about_mean(truth.points_mm[some, :2].T, one, count)[1]
    (motion,) = rigid_motions(points, np.asarray(shear, np.float32), one, count)
    return (*motion.shear_mm, math.nan if motion.twist_deg is None else motion.twist_deg)


def _row(
    sensor: str,
    object_name: str,
    condition: Condition,
    direction_deg: float,
    press: Press,
    truth: Truth,
    motion: tuple[float, float, float],
    result: Reconstruction,
) -> DragRow:
    scored = score(Label(sensor, object_name), KnownTruth.of(truth), result)
    shear_x, shear_y = result.shear_of_contact_mm or (math.nan, math.nan)
    twist = result.objects[0].twist_deg if result.objects else None
    return DragRow(
        profile=result.profile,
        sensor=sensor,
        object=object_name,
        condition=str(condition),
        depth_mm=press.depth_mm,
        drag_mm=math.hypot(press.drag_x_mm, press.drag_y_mm),
        direction_deg=direction_deg,
        twist_deg=press.twist_deg,
        tilt_deg=condition.tilt_deg,
        refused=code_of(result.reason),
        contact=result.contact,
        saturated=result.saturated,
        degraded=result.degraded is not None,
        true_depth_mm=truth.depth_max_mm,
        found_depth_mm=result.depth_max_mm,
        me_mm=scored.me_mm,
        backward_mm=scored.backward_mm,
        sd_pct=scored.sd_pct,
        iou=scored.iou,
        true_shear_x_mm=motion[0],
        true_shear_y_mm=motion[1],
        found_shear_x_mm=shear_x,
        found_shear_y_mm=shear_y,
        true_twist_deg=motion[2],
        found_twist_deg=math.nan if twist is None else twist,
    )
