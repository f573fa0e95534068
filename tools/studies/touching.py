"""How many objects are found where two of them touch each other,
and where there is one long or branched object.

::

    .venv/bin/python -m tools.studies.touching [--profile NAME...] [--sensors SEED,... | --final]
        [--references N]
        [--presses N] [--out DIR]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from tacshade_edge.lab.simulator.drag import contact_nodes
from tacshade_edge.lab.simulator.press import OBJECTS, Press, Shape, ball, distances_mm, polygon
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import node_directions
from tacshade_edge.lab.simulator.truth import SimulatedFrame
from tacshade_edge.lab.studies.evaluate.work import (
    PRESSES,
    REFERENCES,
    SensorName,
    family_of,
    reconstructor,
)
from tacshade_edge.lab.studies.markdown import grouped, summary
from tacshade_edge.types import F64, Calibration, Frame, Reconstruction
from tools.studies import command
from tools.testbed.simulator.families import FINAL_SENSORS

SENSORS = "default,5,other:31,other:32"
FINAL = FINAL_SENSORS[2::3]
"""One of each family: `parting.EVIDENCE` was raised after a look at the others."""
GAPS_MM = (0.0, 0.5, 1.0)
DEPTHS_MM = (1.5, 4.5)
FARTHEST = 0.25
"""Greatest distance of a place from the tip, in skin radii."""
DRAG_MM = 2.0
PAIR_PLACES, SINGLE_PLACES = 5, 3
NOISE = 9000
LEAST_MM = 0.5
"""Least true depth of an object that counts; depths,
drags and sizes are those on a skin of 20 mm.
"""
_HEIGHT_MM = 30.0


@dataclass(frozen=True, slots=True)
class Part:
    """One of two objects: its shape, the distance from its axis to the face
    that the other one touches, its scale.
    """

    shape: Shape
    half_mm: float
    scale: float


def _ball(radius_mm: float) -> Part:
    return Part(ball(1.0), radius_mm, radius_mm)


def _cube(side_mm: float) -> Part:
    return Part(OBJECTS["cube"](), side_mm / 2, side_mm / 10)


PAIRS: dict[str, Callable[[], tuple[Part, Part]]] = {
    "two balls": lambda: (_ball(4.25), _ball(4.25)),
    "ball beside cube": lambda: (_ball(5.0), _cube(9.0)),
}


def _upright(name: str, vertices: Sequence[tuple[float, float]]) -> Shape:
    """A polygon that stands on z = 0."""
    outline = polygon(vertices)
    half_mm = _HEIGHT_MM / 2

    def sdf(p: F64) -> F64:
        return np.asarray(
            np.maximum(outline(p[:, 0], p[:, 1]), np.abs(p[:, 2] - half_mm) - half_mm)
        )

    return Shape(name, sdf)


def _lying_cylinder() -> Shape:
    def sdf(p: F64) -> F64:
        side = np.hypot(p[:, 1], p[:, 2] - 3.0) - 3.0
        return np.asarray(np.maximum(side, np.abs(p[:, 0]) - 8.0))

    return Shape("lying_cylinder", sdf)


def _star() -> list[tuple[float, float]]:
    turns = [math.pi * k / 5 for k in range(10)]
    return [
        ((7.0 if k % 2 == 0 else 3.2) * math.cos(a), (7.0 if k % 2 == 0 else 3.2) * math.sin(a))
        for k, a in enumerate(turns)
    ]


_L = [(-5.0, -6.0), (5.0, -6.0), (5.0, -2.5), (-1.5, -2.5), (-1.5, 6.0), (-5.0, 6.0)]
_T = [
    *((-6.5, 1.5), (-1.75, 1.5), (-1.75, -6.0), (1.75, -6.0)),
    *((1.75, 1.5), (6.5, 1.5), (6.5, 5.0), (-6.5, 5.0)),
]
SINGLES: dict[str, Callable[[], Shape]] = {
    **{name: make for name, make in OBJECTS.items() if name != "two_balls"},
    "lying_cylinder": _lying_cylinder,
    "L": partial(_upright, "L", _L),
    "T": partial(_upright, "T", _T),
    "star": partial(_upright, "star", _star()),
}


@dataclass(frozen=True, slots=True)
class TouchingRow:
    """One frame by one profile: the number of objects that touch the skin,
    of connected contacts and of objects found.

    `own_part` is the part of the points that have the number of the object that is nearest to them,
    NaN unless two were found of two.
    """

    profile: str
    sensor: str
    scene: str
    gap_mm: float
    dragged: bool
    depth_mm: float
    true_objects: int
    connected: int
    objects: int
    own_part: float


def pair_presses(
    model: SensorModel, parts: Sequence[Part], gap_mm: float, middle: Press
) -> tuple[Press, ...]:
    """Two objects on one level, a gap apart, with the middle of the gap at a press, which they are
    turned, pressed and dragged like.

    Raises ValueError if one is not over the skin.
    """
    scale, turn = model.skin_radius_mm / 20, math.radians(middle.rotation_deg)
    made = []
    for part, side in zip(parts, (-1, 1), strict=True):
        away_mm = side * (part.half_mm * scale + gap_mm / 2)
        x_mm = middle.x_mm + away_mm * math.cos(turn)
        y_mm = middle.y_mm + away_mm * math.sin(turn)
        level = Press(part.shape, x_mm, y_mm, 0.0).lowest_z_mm(model.skin_radius_mm)
        depth_mm = level - middle.lowest_z_mm(model.skin_radius_mm)
        made.append(
            Press(
                part.shape,
                x_mm,
                y_mm,
                depth_mm,
                middle.rotation_deg,
                part.scale * scale,
                drag_x_mm=middle.drag_x_mm,
                drag_y_mm=middle.drag_y_mm,
            )
        )
    return tuple(made)


def _middles(model: SensorModel, seed: int | None, scene: str, count: int) -> Iterator[Press]:
    """Presses, half of them dragged, at places drawn from the sensor and the scene."""
    number = (*PAIRS, *SINGLES).index(scene)
    rng = np.random.default_rng((0 if seed is None else seed + 1, 51, number))
    scale, shape = model.skin_radius_mm / 20, SINGLES.get(scene, ball)()
    for k in range(2 * count):
        rho = FARTHEST * model.skin_radius_mm * rng.uniform()
        angle, way = rng.uniform(0, 2 * math.pi, 2)
        turn_deg, depth_mm = rng.uniform(0, 360), scale * rng.uniform(*DEPTHS_MM)
        drag_mm = DRAG_MM * scale if k % 2 else 0.0
        yield Press(
            shape,
            rho * math.cos(angle),
            rho * math.sin(angle),
            depth_mm,
            turn_deg,
            scale,
            drag_x_mm=drag_mm * math.cos(way),
            drag_y_mm=drag_mm * math.sin(way),
        )


def _scenes(
    model: SensorModel, seed: int | None, scene: str
) -> Iterator[tuple[float, Press, tuple[Press, ...]]]:
    """The gap (NaN for one object), the press that stands for the scene, and all presses."""
    if scene in SINGLES:
        for press in _middles(model, seed, scene, SINGLE_PLACES):
            yield math.nan, press, (press,)
        return
    parts = PAIRS[scene]()
    for middle in _middles(model, seed, scene, PAIR_PLACES):
        for gap_mm in GAPS_MM:
            yield gap_mm, middle, pair_presses(model, parts, gap_mm, middle)


def rows(profiles: Sequence[str], task: tuple[SensorName, Calibration, str]) -> list[TouchingRow]:
    """Press and drag the objects of a scene on a sensor."""
    name, calibration, scene = task
    sensor = name.make()
    made = [reconstructor(calibration, profile) for profile in profiles]
    found = []
    for k, (gap_mm, middle, presses) in enumerate(_scenes(sensor.model, name.seed, scene)):
        frame = sensor.frame(presses, NOISE + k)
        if not _all_touch(frame):
            continue
        for each in made:
            result = each.step(Frame(0, 0, 0, frame.image))
            contacts, _ = cv2.connectedComponents(result.height.contact.view(np.uint8))
            found.append(
                TouchingRow(
                    each.profile.name,
                    str(name),
                    scene,
                    gap_mm,
                    middle.is_dragged,
                    middle.depth_mm,
                    len(presses),
                    contacts - 1,
                    len(result.objects),
                    _own_part(result, frame),
                )
            )
    return found


def _all_touch(frame: SimulatedFrame) -> bool:
    """Whether every object is pressed in by at least `LEAST_MM`."""
    skin, presses = frame.skin, frame.presses
    owner, points = contact_nodes(skin, node_directions(skin.radius_mm), presses)[2:]
    depths_mm = skin.radius_mm - np.linalg.norm(points, axis=1)
    least_mm = LEAST_MM * skin.radius_mm / 20
    return all((depths_mm[owner == k] >= least_mm).any() for k in range(len(presses)))


def _own_part(result: Reconstruction, frame: SimulatedFrame) -> float:
    if len(result.objects) != 2 or len(frame.presses) != 2:
        return math.nan
    points_mm = result.cloud.points_mm.astype(np.float64)
    apart_mm = distances_mm(frame.presses, frame.skin.radius_mm, points_mm)
    nearest = np.abs(apart_mm).argmin(axis=0)
    same = float(np.mean(nearest == result.cloud.labels - 1))
    return max(same, 1 - same)


def right(some: Sequence[TouchingRow]) -> str:
    """The part of frames with the right number of objects."""
    return _percent([row.objects == row.true_objects for row in some])


def _connected(some: Sequence[TouchingRow]) -> str:
    return _percent([row.connected == row.true_objects for row in some])


def _of_scene(scene: str) -> Callable[[Sequence[TouchingRow]], str]:
    return lambda some: right([row for row in some if row.scene == scene])


def _own(some: Sequence[TouchingRow]) -> str:
    known = [row.own_part for row in some if not math.isnan(row.own_part)]
    return f"{100 * np.mean(known):.1f}" if known else ""


def _percent(values: Sequence[bool]) -> str:
    return f"{100 * np.mean(values):.0f}" if values else ""


TWO: Mapping[str, Callable[[Sequence[TouchingRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "connected right %": _connected,
    "right %": right,
    **{f"{scene} %": _of_scene(scene) for scene in PAIRS},
    "points right %": _own,
}
ONE: Mapping[str, Callable[[Sequence[TouchingRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "in several contacts": lambda some: str(sum(row.connected > 1 for row in some)),
    "split": lambda some: str(sum(row.objects > max(row.connected, 1) for row in some)),
    "split %": lambda some: f"{100 * np.mean([_split(row) for row in some]):.1f}",
    "missed": lambda some: str(sum(row.objects == 0 for row in some)),
}


def _split(row: TouchingRow) -> bool:
    return row.objects > max(row.connected, 1)


def text(found: Sequence[TouchingRow]) -> str:
    """Two objects by gap and motion, and one object by method and by shape."""
    pairs = [row for row in found if row.true_objects == 2]
    by_gap = [
        ((f"{gap:g} mm, {'dragged' if dragged else 'pressed'}", profile), some)
        for profile, of in grouped(pairs, "profile").items()
        for (gap, dragged), some in grouped(of, lambda row: (row.gap_mm, row.dragged)).items()
    ]
    by_family = [
        ((f"{family}, {'0' if touches else '0.5 and 1'} mm", profile), some)
        for profile, of in grouped(pairs, "profile").items()
        for (family, touches), some in grouped(
            of, lambda row: (family_of(row.sensor), row.gap_mm == 0)
        ).items()
    ]
    singles = [row for row in found if row.true_objects == 1]
    by_profile = [((name,), some) for name, some in grouped(singles, "profile").items()]
    by_shape = [((name,), some) for name, some in grouped(singles, "scene").items()]
    return "\n\n".join(
        (
            "Two objects, by gap",
            summary(("what", "method"), sorted(by_gap, key=lambda group: group[0][0]), TWO),
            "Two objects, by family",
            summary(("what", "method"), by_family, TWO),
            "One object",
            summary(("method",), by_profile, ONE),
            summary(("object",), by_shape, ONE),
        )
    )


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Objects that touch each other, and single ones.", SENSORS, FINAL)
    parser.add_argument("--references", type=int, default=REFERENCES, metavar="N")
    parser.add_argument("--presses", type=int, default=PRESSES, metavar="N", help="0: none")
    scenes = (*PAIRS, *SINGLES)
    parser.add_argument("--scenes", nargs="+", choices=scenes, default=scenes, metavar="NAME")
    args = parser.parse_args(words)
    command.check_presses(parser, args.presses)
    work = partial(
        command.over_sensors,
        partial(rows, args.profile),
        args.sensors,
        args.scenes,
        fitted=args.fitted,
    )
    work = partial(work, references=args.references, presses=args.presses)
    command.run(parser, args, "touching", work, text, {"": TouchingRow})


if __name__ == "__main__":
    main()
