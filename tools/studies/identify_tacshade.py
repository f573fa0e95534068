"""Search print, light, skin, camera and readings of the text for a sensor on
which the paper's method gives Table I.

::

    .venv/bin/python -m tools.studies.identify_tacshade --kept tacshade.jsonl [--random 400]
        [--refined 200]

Each line of the file is a sensor tried, so a stopped search goes on where it was. The first sensors
are drawn; later ones vary one of the best so far. Images are halved.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.accuracy import PAPER_ROW, TABLE_I
from tacshade_edge.lab.studies.evaluate.work import one_thread
from tacshade_edge.lab.studies.markdown import markdown
from tools.studies.paper_readings import PressedObject, Reading, calibrated, pressed_object, scores

HEIGHT_PX, WIDTH_PX = 240, 320
HALVED_STRIDE_PX = 2
DISC_PART = 0.46
PARENTS = 8
"""A later sensor varies one of this many best ones."""
OTHER_READING = 0.4
PART = 0.12
"""Standard deviation of a variation, as a part of a parameter's range."""
NEAR = 1.3
"""An ME agrees with Table I's within this factor."""
LEAST_ME_MM, MEAN_PART = 0.01, 0.2

RANGES: dict[str, tuple[float, float]] = {
    "depth_mm": (1.5, 5.5),
    "object_scale": (0.7, 1.4),
    "skin_radius_mm": (16.0, 30.0),
    "camera_distance_mm": (6.0, 60.0),
    "visible_half_angle_deg": (38.0, 58.0),
    "pitch_mm": (1.0, 3.0),
    "pin_length_pitches": (0.4, 2.2),
    "pin_tip_radius_pitches": (0.15, 0.42),
    "pin_base_radius_pitches": (0.12, 0.42),
    "marker_radius_pitches": (0.2, 0.5),
    "size_tolerance": (0.0, 0.08),
    "skin_decay_mm": (0.6, 6.0),
    "friction": (0.0, 1.0),
    "bulge": (0.0, 1.0),
    "vignetting": (0.0, 0.6),
    "blur_px": (0.2, 1.5),
}
"""What is searched: the presses' depth, the objects' size (1: ours, on a skin of 20 mm), and
parameters of `SensorModel`, beyond the training family's ranges.
"""
MODEL = tuple(name for name in RANGES if name not in ("depth_mm", "object_scale"))
PROMISING_MM = 0.5
"""A sensor whose ball has a greater ME by every reading is given up:
the ball is Table I's best object.
"""
ORTHOGRAPHIC = 0.25
"""Part of the sensors with the paper's orthographic camera."""
READINGS = tuple(
    Reading(window, weight, saturates, registered, stride_px=HALVED_STRIDE_PX)
    for window, weight, saturates, registered in product(
        (1, 2, 3), (0.1, 0.3), (False, True), (False, True)
    )
)
TRUE_ME_MM = tuple(TABLE_I[name][0] for name in PAPER_OBJECTS)


@dataclass(frozen=True, slots=True)
class Tried:
    """A sensor: its number, the values searched (a distance of None is orthographic),
    its best reading, its MEs.
    """

    number: int
    values: dict[str, float | None]
    reading: Reading | None
    me_mm: tuple[float, ...]
    loss: float

    def line(self) -> str:
        """One line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def parse(cls, line: str) -> Tried:
        """Read a line that `line` wrote."""
        found: dict[str, Any] = json.loads(line)
        reading = found.pop("reading")
        me_mm = tuple(found.pop("me_mm"))
        return cls(**found, reading=reading and Reading(**reading), me_mm=me_mm)

    def model(self, print_seed: int, halved: bool = True) -> SensorModel:
        """The sensor with a print of a seed."""
        size = (HEIGHT_PX, WIDTH_PX) if halved else (2 * HEIGHT_PX, 2 * WIDTH_PX)
        values: dict[str, Any] = {
            name: value for name, value in self.values.items() if name in MODEL
        }
        if not halved:
            values["blur_px"] *= 2
        usual = random_model(0, *size)
        centred = replace(usual, row_c=(size[0] - 1) / 2, col_c=(size[1] - 1) / 2)
        return replace(
            centred,
            disc_radius_px=DISC_PART * size[0],
            print_seed=print_seed,
            specular_spots=0,
            **values,
        )

    def pressed(
        self, sensor: SimulatedSensor, name: str, place_mm: tuple[float, float] = (0.0, 0.0)
    ) -> PressedObject:
        """Press one of the five objects. Raises ValueError if it touches nothing."""
        depth_mm, scale = self.values["depth_mm"], self.values["object_scale"]
        made = pressed_object(sensor, name, float(depth_mm or 0), place_mm, float(scale or 0))
        if not len(made.truth.points_mm):
            raise ValueError(f"{name} touches nothing")
        return made


def loss(me_mm: Sequence[float]) -> float:
    """The greatest logarithm of a ratio to Table I's MEs, in either direction, and a little of
    their mean; infinite for an object that is not found.
    """
    if not np.isfinite(me_mm).all():
        return math.inf
    off = np.abs(np.log(np.maximum(me_mm, LEAST_ME_MM) / np.array(TRUE_ME_MM)))
    return float(off.max() + MEAN_PART * off.mean())


def agrees(me_mm: Sequence[float]) -> bool:
    """Whether all five MEs are within `NEAR` of Table I's, in its order."""
    ratios = np.array(me_mm) / np.array(TRUE_ME_MM)
    within = bool(((ratios <= NEAR) & (ratios >= 1 / NEAR)).all())
    return within and np.argsort(me_mm).tolist() == np.argsort(TRUE_ME_MM).tolist()


def drawn(number: int) -> dict[str, float | None]:
    """Draw a sensor's values."""
    rng = np.random.default_rng((number, 61))
    values: dict[str, float | None] = {
        name: float(rng.uniform(*span)) for name, span in RANGES.items()
    }
    if rng.random() < ORTHOGRAPHIC:
        values["camera_distance_mm"] = None
    return values


def varied(number: int, parents: Sequence[Tried]) -> tuple[dict[str, float | None], Reading]:
    """Vary about a half of the values of one of the parents, and sometimes its reading."""
    rng = np.random.default_rng((number, 62))
    parent = parents[int(rng.integers(len(parents)))]
    values = dict(parent.values)
    for name, (low, high) in RANGES.items():
        value, step = values[name], rng.normal(0, PART * (high - low))
        if value is not None and rng.random() < 0.5:
            values[name] = float(np.clip(value + step, low, high))
    other = READINGS[int(rng.integers(len(READINGS)))]
    return values, other if rng.random() < OTHER_READING else parent.reading or Reading()


def tried(number: int, values: dict[str, float | None], readings: Sequence[Reading]) -> Tried:
    """Press the five objects into a sensor, and keep the reading nearest to Table I."""
    best = nothing = Tried(number, values, None, (), math.inf)
    try:
        sensor = SimulatedSensor(nothing.model(number))
        calibration = calibrated(sensor)
        ball = nothing.pressed(sensor, "ball")
        if not any(
            found[0].me_mm < PROMISING_MM for _, found in scores(calibration, [ball], readings)
        ):
            return nothing
        pressed = [
            ball if name == "ball" else nothing.pressed(sensor, name) for name in PAPER_OBJECTS
        ]
    except (ConfigError, ValueError):  # what cannot be calibrated, made or pressed
        return nothing
    for reading, found in scores(calibration, pressed, readings):
        me_mm = tuple(each.me_mm for each in found)
        if loss(me_mm) < best.loss:
            best = Tried(number, values, reading, me_mm, loss(me_mm))
    return best


def best_of(found: Sequence[Tried], count: int) -> list[Tried]:
    """The sensors nearest to Table I, the nearest first."""
    whole = [each for each in found if math.isfinite(each.loss)]
    return sorted(whole, key=lambda each: each.loss)[:count]


def search(kept: Path, random: int, refined: int) -> Iterator[Tried]:
    """Yield every sensor tried, old and new; each new one is a line of the file
    before the next begins.
    """
    done = [Tried.parse(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    yield from done
    with kept.open("a", encoding="utf-8") as file:
        for number in range(len(done), random + refined):
            if number < random:
                done.append(tried(number, drawn(number), READINGS))
            else:
                values, reading = varied(number, best_of(done, PARENTS))
                done.append(tried(number, values, [reading]))
            file.write(done[-1].line() + "\n")
            file.flush()
            yield done[-1]


def text(found: Sequence[Tried]) -> str:
    """What was tried, the best, and the very best's values."""
    shown = best_of(found, SHOWN)
    best = shown[0]
    lines = [(PAPER_ROW, TRUE_ME_MM), *((f"number {each.number}", each.me_mm) for each in shown)]
    whole = sum(math.isfinite(each.loss) for each in found)
    agreeing = sum(bool(each.me_mm) and agrees(each.me_mm) for each in found)
    values = ", ".join(
        f"{name} {'none' if value is None else format(value, '.3g')}"
        for name, value in best.values.items()
    )
    return "\n\n".join(
        (
            (
                f"{len(found)} sensors by {len(READINGS)} readings; {whole} with an ME of the ball "
                f"below {PROMISING_MM} mm; {agreeing} with Table I's order and MEs within "
                f"{100 * (NEAR - 1):.0f} %"
            ),
            me_table(lines),
            f"The best: {best.reading}; {values}",
        )
    )


SHOWN = 3


def me_table(lines: Sequence[tuple[str, Sequence[float]]]) -> str:
    """Named MEs of the five objects, each line's greatest ratio to Table I's in either direction,
    whether it agrees.
    """
    rows = []
    for what, me_mm in lines:
        ratio = np.exp(np.abs(np.log(np.array(me_mm) / np.array(TRUE_ME_MM))).max())
        agreement = "yes" if agrees(me_mm) else "no"
        rows.append([what, *(f"{value:.3f}" for value in me_mm), f"{ratio:.2f}", agreement])
    return markdown(["sensor", *PAPER_OBJECTS, "greatest ratio", "agrees"], rows)


def main(words: Sequence[str] | None = None) -> int:
    """Search and print the best."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kept", type=Path, required=True, metavar="FILE.jsonl")
    parser.add_argument("--random", type=int, default=400, metavar="N")
    parser.add_argument("--refined", type=int, default=200, metavar="N")
    args = parser.parse_args(words)
    with one_thread():
        found = list(search(args.kept, args.random, args.refined))
        print(text(found))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
