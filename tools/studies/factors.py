#!/usr/bin/env python3
"""What the factor that forty balls show is worth on Table I's objects, pressed and dragged.

::

    .venv/bin/python -m tools.studies.factors [--sensors 5,other:31] [--states STATES]
        [--families third,layered] [--range working] [--count 4] [--mixed]

Each sensor is calibrated on references and presses of balls; the heights of the shipped networks
are then judged with the factor that `calibrate` found, and without. ``best`` is the factor that
would have made the errors of both kinds of contact least. With STATES (a folder of solved states
for each family), strangers (strangers/README.md) are judged beside the simulator's own sensors.
``--mixed`` presses the own sensors with flat ends, a square and a bar as well.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacshade_edge.calibration.calibrate import CalibrationResult
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, score
from tacshade_edge.lab.studies.evaluate.work import reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.profiles import LADDER
from tacshade_edge.types import Calibration, Frame
from tools.studies.fit import calibrated as calibrated_own
from tools.studies.fit_presses import pressed
from tools.studies.fit_scores import judged_scenes
from tools.studies.strangers.families import FAMILIES
from tools.studies.strangers.sensor import Seen
from tools.studies.strangers.sensor import calibrated as calibrated_stranger
from tools.testbed.simulator.families import sensor_name

OWN = "5,11,21,other:31,other:32,other:33,other:34"
EVERY = 3
"""One in so many of the own sensors' scenes is judged."""
FACTORS = tuple(float(factor) for factor in np.exp(np.arange(-0.4, 0.41, 0.1)))
"""Among which the best one is sought."""


@dataclass(frozen=True, slots=True)
class Judged:
    """A profile on one sensor: the factor found, the best one, and the ratio of errors with the
    factor to those without, pressed and dragged.
    """

    sensor: str
    profile: str
    factor: float
    best: float
    pressed: float
    dragged: float


def own(text: str, *, mixed: bool) -> tuple[CalibrationResult, list[Seen]]:
    """Calibrate a simulated sensor and see Table I's objects with it."""
    name = sensor_name(text)
    sensor = name.make()
    result = calibrated_own(sensor, pressed(sensor, name.seed or 0, balls=not mixed))
    seen = []
    scenes = [each for each in judged_scenes(sensor, name.seed) if each[0] != "beyond"]
    for what, scene in scenes[::EVERY]:
        frame = sensor.frame((scene.press,), scene.noise_seed)
        truth = KnownTruth.of(frame.truth())
        seen.append(Seen(scene.object_name, what == "dragged", frame.image, truth))
    return result, seen


def errors_mm(
    calibration: Calibration, profile: str, factor: float, seen: Sequence[Seen]
) -> tuple[float, float]:
    """The mean error with a factor, pressed and dragged."""
    made = reconstructor(replace(calibration, factors={profile: factor}), profile)
    off: dict[bool, list[float]] = {False: [], True: []}
    for each in seen:
        found = made.step(Frame(0, 0, 0, each.image))
        off[each.dragged].append(score(Label("", each.object_name), each.truth, found).me_mm)
    return float(np.nanmean(off[False])), float(np.nanmean(off[True]))


def judged(sensor: str, result: CalibrationResult, seen: Sequence[Seen]) -> Iterator[Judged]:
    """Judge every profile."""
    calibration = result.calibration
    for profile in LADDER:
        factor = calibration.factors.get(profile, 1.0)
        before, after = (errors_mm(calibration, profile, f, seen) for f in (1.0, factor))
        sums = [sum(errors_mm(calibration, profile, each, seen)) for each in FACTORS]
        best = FACTORS[int(np.argmin(sums))]
        yield Judged(sensor, profile, factor, best, after[0] / before[0], after[1] / before[1])


def lines(rows: Sequence[Judged]) -> list[list[str]]:
    """The table's lines: each sensor's, then means and worst of factors above and below 1."""
    made = [
        [r.sensor, r.profile, f"{r.factor:.2f}", f"{r.best:.2f}", *_shown(r.pressed, r.dragged)]
        for r in rows
    ]
    kinds = {
        "all": list(rows),
        "factors below 1": [row for row in rows if row.factor < 1],
        "factors above 1": [row for row in rows if row.factor > 1],
    }
    for name, some in kinds.items():
        if not some:
            continue
        for what, of in (("mean", np.mean), ("worst", np.max)):
            figures = [
                float(of([getattr(r, kind) for r in some])) for kind in ("pressed", "dragged")
            ]
            made.append([name, what, f"{len(some)} networks", "", *_shown(*figures)])
    return made


def _shown(*ratios: float) -> list[str]:
    return [f"{ratio:.2f}" for ratio in ratios]


def of_strangers(
    families: Sequence[str], range_name: str, count: int, states: Path
) -> list[Judged]:
    """Judge strangers; those whose presses are refused are named and left out.

    Raises FileNotFoundError (not solved).
    """
    rows: list[Judged] = []
    for family in families:
        for number in range(count):
            stranger = FAMILIES[family](range_name, number, states / family)
            try:
                result = calibrated_stranger(stranger, stranger.balls())
            except ConfigError as error:
                print(f"{family} {number}: {error}", file=sys.stderr)
                continue
            rows += judged(f"{family} {number}", result, list(stranger.judged()))
    return rows


def main(words: Sequence[str] | None = None) -> int:
    """Judge and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensors", default=OWN, help="of the simulator's own; empty: none")
    parser.add_argument("--states", type=Path, help="a folder for each family of strangers")
    parser.add_argument("--families", default=",".join(FAMILIES))
    parser.add_argument("--range", choices=("working", "final"), default="working")
    parser.add_argument("--count", type=int, default=4, help="strangers of each family")
    parser.add_argument("--mixed", action="store_true", help="own sensors: not balls alone")
    args = parser.parse_args(words)
    families, sensors = args.families.split(","), list(filter(None, args.sensors.split(",")))
    try:
        for name in families:
            if name not in FAMILIES:
                raise ValueError(f"found {name!r}, expected one of {', '.join(FAMILIES)}")
        for text in sensors:
            sensor_name(text)
    except ValueError as error:
        parser.error(str(error))
    try:
        strangers = (
            of_strangers(families, args.range, args.count, args.states) if args.states else []
        )
    except FileNotFoundError as error:
        print(f"{error.filename} is missing: solve the family first (README.md)", file=sys.stderr)
        return 1
    rows = [row for text in sensors for row in judged(text, *own(text, mixed=args.mixed))]
    rows += strangers
    headings = ["sensor", "method", "factor", "best", "pressed: of without", "dragged: of without"]
    print(markdown(headings, lines(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
