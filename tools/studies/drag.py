"""How depth and shear are found when objects are dragged, twisted and tilted.

::

    .venv/bin/python -m tools.studies.drag [--profile NAME...] [--sensors SEED,... | --final]
        [--objects NAME,...]
        [--references N] [--presses N] [--out DIR]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from typing import Any

import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedFrame, Truth
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, Row, score
from tacshade_edge.lab.studies.evaluate.work import SensorName, family_of, reconstructor
from tacshade_edge.lab.studies.markdown import grouped, summary
from tacshade_edge.sensor.contact.objects import rigid_motion, spreads
from tacshade_edge.types import F64, Bool, Calibration, Frame, Reconstruction
from tools.studies import command
from tools.testbed.simulator.families import FINAL_SENSORS

SENSORS = "default,5,other:31,other:32"
FINAL = tuple(FINAL_SENSORS[k] for k in (0, 1, 3, 4))
"""Two of each family: a dragged frame takes a second."""
DIRECTIONS = 4
DEPTHS_MM = (1.0, 2.75, 4.5)
FARTHEST = 0.3
"""Greatest distance of a place from the tip, in skin radii."""
NOISE = 6000
_TRUE_POINTS = 4000
"""Number of a contact's points that give the skin's true motion."""
TELLING_MM = 0.5
"""Least true shear at which its direction counts, mm."""
WRONG, WRONG_MM = 0.25, 0.3
"""Errors, as a ratio and in mm, beyond which a depth is wrong."""


@dataclass(frozen=True, slots=True)
class Condition:
    """What is done to an object in addition to pressing it; lengths on a skin of 20 mm."""

    drag_mm: float = 0.0
    twist_deg: float = 0.0
    tilt_deg: float = 0.0

    def __str__(self) -> str:
        """For a table."""
        turned = (
            f"{name} {deg:g}°"
            for name, deg in (("twist", self.twist_deg), ("tilt", self.tilt_deg))
            if deg
        )
        return ", ".join((f"{self.drag_mm:g} mm", *turned))


CONDITIONS = (
    Condition(),
    Condition(1.0),
    Condition(2.0),
    Condition(3.0),
    Condition(3.0, 10.0, 15.0),
)


@dataclass(frozen=True, slots=True)
class DragRow(Row):
    """One frame by one profile; drags in mm of this sensor,
    shears and twists are means over the contact.
    """

    condition: str
    drag_mm: float
    direction_deg: float
    twist_deg: float
    tilt_deg: float
    true_shear_x_mm: float
    true_shear_y_mm: float
    true_twist_deg: float
    found_shear_x_mm: float
    found_shear_y_mm: float
    found_twist_deg: float


def presses(
    model: SensorModel, seed: int | None, object_name: str
) -> Iterator[tuple[Condition, float, Press]]:
    """Every condition, direction in degrees and depth of an object;
    the same places and tilts for every condition.
    """
    scale, shape = model.skin_radius_mm / 20, OBJECTS[object_name]()
    for condition in CONDITIONS:
        rng = np.random.default_rng(
            (0 if seed is None else seed + 1, 31, list(OBJECTS).index(object_name))
        )
        for k in range(DIRECTIONS):
            farthest = (FARTHEST * model.skin_radius_mm, 2 * math.pi, 360, 2 * math.pi)
            rho, angle, turn, lean = rng.uniform((0, 0, 0, 0), farthest)
            direction = 360 * (k + rng.uniform()) / DIRECTIONS
            along, drag_mm, tilt = (
                math.radians(direction),
                condition.drag_mm * scale,
                condition.tilt_deg,
            )
            for depth_mm in DEPTHS_MM:
                press = Press(
                    shape,
                    rho * math.cos(angle),
                    rho * math.sin(angle),
                    depth_mm * scale,
                    turn,
                    scale,
                    tilt * math.cos(lean),
                    tilt * math.sin(lean),
                    drag_mm * math.cos(along),
                    drag_mm * math.sin(along),
                    condition.twist_deg * (1 if k % 2 else -1),
                )
                yield condition, direction, press


def rows(profiles: Sequence[str], task: tuple[SensorName, Calibration, str]) -> list[DragRow]:
    """Drag an object over a sensor."""
    name, calibration, object_name = task
    sensor = name.make()
    made = [reconstructor(calibration, profile) for profile in profiles]
    found = []
    for k, (condition, direction, press) in enumerate(
        presses(sensor.model, name.seed, object_name)
    ):
        frame = sensor.frame((press,), NOISE + k)
        truth = frame.truth()
        if not len(truth.points_mm):
            continue
        known, moved = KnownTruth.of(truth), _true_motion(frame, truth)
        label = Label(
            str(name), object_name, "", press.depth_mm, press.x_mm, press.y_mm, press.rotation_deg
        )
        drag_mm = math.hypot(press.drag_x_mm, press.drag_y_mm)
        done = (str(condition), drag_mm, direction, press.twist_deg, condition.tilt_deg)
        for each in made:
            result = each.step(Frame(0, 0, 0, frame.image))
            values: tuple[Any, ...] = (
                *astuple(score(label, known, result)),
                *done,
                *moved,
                *_found_motion(result),
            )
            found.append(DragRow(*values))
    return found


def _true_motion(frame: SimulatedFrame, truth: Truth) -> tuple[float, float, float]:
    """Mean shear and twist of the skin that truly touches."""
    rows, cols = np.nonzero(truth.contact)
    some = slice(None, None, -(-len(rows) // _TRUE_POINTS))
    shear = frame.shear_mm(rows[some].astype(float), cols[some].astype(float)).T
    count = shear.shape[1]
    (mean,), (spread,) = spreads(
        np.concatenate((truth.points_mm[some].T, shear), dtype=np.float64), [count]
    )
    twist_deg, _ = rigid_motion(spread, count)
    return (mean[3], mean[4], math.nan if twist_deg is None else twist_deg)


def _found_motion(result: Reconstruction) -> tuple[float, float, float]:
    twist = result.objects[0].twist_deg if result.objects else None
    return (
        *(result.shear_of_contact_mm or (math.nan, math.nan)),
        math.nan if twist is None else twist,
    )


def me_mm(some: Sequence[DragRow]) -> float:
    """Mean ME; a missed contact counts as its true depth."""
    return float(
        np.mean([row.true_depth_mm if math.isnan(row.me_mm) else row.me_mm for row in some])
    )


def silently_wrong(row: DragRow) -> bool:
    """Whether the greatest depth is wrong by a quarter and 0.3 mm, and nothing says so."""
    off_mm = abs(row.found_depth_mm - row.true_depth_mm)
    return off_mm > max(WRONG * row.true_depth_mm, WRONG_MM) and not (row.saturated or row.degraded)


def _shears(some: Sequence[DragRow]) -> tuple[F64, F64]:
    """True and found shear (n, 2) where one is found."""
    both = np.array(
        [
            (r.true_shear_x_mm, r.true_shear_y_mm, r.found_shear_x_mm, r.found_shear_y_mm)
            for r in some
        ]
    )
    both = both[np.isfinite(both[:, 2:]).all(axis=1)]
    return both[:, :2], both[:, 2:]


def shear_off_mm(some: Sequence[DragRow], part: float) -> float:
    """A quantile of the distance between true and found shear."""
    true, found = _shears(some)
    return _quantile(np.linalg.norm(found - true, axis=1), part)


def _within(some: Sequence[DragRow]) -> str:
    true, found = _shears(some)
    near: Bool = np.linalg.norm(found - true, axis=1) <= np.maximum(
        0.35, 0.1 * np.linalg.norm(true, axis=1)
    )
    return f"{100 * near.mean() if len(near) else math.nan:.0f}"


def _direction_off(some: Sequence[DragRow]) -> str:
    true, found = (one.T for one in _shears(some))
    turned = np.arctan2(
        true[0] * found[1] - true[1] * found[0], true[0] * found[0] + true[1] * found[1]
    )
    return f"{_quantile(np.degrees(np.abs(turned[np.hypot(*true) > TELLING_MM])), 0.95):.0f}"


def _twist_off(some: Sequence[DragRow]) -> str:
    off = np.array([row.found_twist_deg - row.true_twist_deg for row in some])
    return f"{_quantile(np.abs(off[np.isfinite(off)]), 0.95):.1f}"


def _quantile(values: F64, part: float) -> float:
    return float(np.quantile(values, part)) if len(values) else math.nan


FIGURES: dict[str, Callable[[Sequence[DragRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "refused": lambda some: str(sum(not row.valid for row in some)),
    "missed": lambda some: str(sum(row.valid and not row.contact for row in some)),
    "ME mm": lambda some: f"{me_mm(some):.3f}",
    "SD %": lambda some: f"{np.mean([row.sd_pct for row in some]):.1f}",
    "IoU": lambda some: f"{np.mean([row.iou for row in some]):.2f}",
    "silently wrong": lambda some: str(sum(map(silently_wrong, some))),
    "shear off mm: median": lambda some: f"{shear_off_mm(some, 0.5):.2f}",
    "95 %": lambda some: f"{shear_off_mm(some, 0.95):.2f}",
    "within 0.35 mm or a tenth %": _within,
    "direction off °: 95 %": _direction_off,
    "twist off °: 95 %": _twist_off,
}


def text(found: Sequence[DragRow]) -> str:
    """A table for each family of sensors, a line for each condition and profile."""
    tables = []
    for family, mine in grouped(found, lambda row: family_of(row.sensor)).items():
        groups = [
            ((what, profile), some)
            for profile, of in grouped(mine, "profile").items()
            for what, some in (*grouped(of, "condition").items(), ("all", of))
        ]
        tables.append(f"Family {family}\n\n{summary(('what', 'method'), groups, FIGURES)}")
    return "\n\n".join(tables)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Objects that are dragged, twisted and tilted.", SENSORS, FINAL)
    command.add_calibration(parser)
    args = parser.parse_args(words)
    command.check_presses(parser, args.presses)
    work = partial(
        command.over_sensors,
        partial(rows, args.profile),
        args.sensors,
        args.objects,
        fitted=args.fitted,
    )
    work = partial(work, references=args.references, presses=args.presses)
    command.run(parser, args, "drag", work, text, {"": DragRow})


if __name__ == "__main__":
    main()
