"""Does what a map leaves of a picture unexplained rank maps as truth does?

::

    .venv/bin/python -m tools.studies.strangers.explained --states STATES
        [--families third,layered,oblate]
        [--range working] [--sensors 2]

Nothing is fitted. The candidates are the shipped networks, whose heights are also made too low and
too high by known factors. Each candidate has a mean error on Table I's objects, pressed and
dragged, and leaves a share of twenty touches without labels unexplained
(`tacshade_edge.lab.fitting.explained`). Spearman's rank correlation between the two is given over
all candidates, and over the networks as they are.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacshade_edge.lab.fitting.explained import Choice, chosen_prints
from tacshade_edge.lab.fitting.identify import identify
from tacshade_edge.lab.studies.evaluate.labelled import spearman
from tacshade_edge.lab.studies.evaluate.score import Label, score
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.types import Calibration, Frame, Reconstruction
from tools.studies.strangers.families import FAMILIES
from tools.studies.strangers.sensor import Stranger, calibrated

FACTORS = (0.6, 0.8, 1.0, 1.25, 1.6)
"""Factors on the heights of a candidate."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A profile whose heights are multiplied by a factor:
    its mean error, and the share of touches that it leaves.
    """

    profile: str
    factor: float
    me_mm: float
    left: float


def scaled(made: Reconstruction, factor: float) -> Reconstruction:
    """The reconstruction with all heights multiplied by a factor."""
    height_mm = made.height.height_mm * np.float32(factor)
    return replace(made, height=replace(made.height, height_mm=height_mm))


def errors_mm(stranger: Stranger, calibration: Calibration, profile: str) -> Mapping[float, float]:
    """The mean error of a profile by factor."""
    reconstructor = make_reconstructor(calibration, PROFILES[profile])
    off_mm: dict[float, list[float]] = {factor: [] for factor in FACTORS}
    for seen in stranger.judged():
        made = reconstructor.step(Frame(0, 0, 0, seen.image))
        for factor, each in off_mm.items():
            label = Label("stranger", seen.object_name)
            each.append(score(label, seen.truth, scaled(made, factor)).me_mm)
    return {factor: float(np.nanmean(each)) for factor, each in off_mm.items()}


def candidates(
    stranger: Stranger, calibration: Calibration, choice: Choice
) -> tuple[Candidate, ...]:
    """Every candidate of a sensor."""
    made = []
    for profile in LADDER:
        of_touches = choice.touches.reconstructed(calibration, profile)
        for factor, me_mm in errors_mm(stranger, calibration, profile).items():
            of_factor = [scaled(each, factor) for each in of_touches]
            left = choice.touches.left(of_factor, choice.twin)
            made.append(Candidate(profile, factor, me_mm, left))
    return tuple(made)


def row(name: str, choice: Choice, found: tuple[Candidate, ...]) -> list[str]:
    """A sensor's line of the table."""
    shipped = [each for each in found if each.factor == 1.0]

    def rank(some: list[Candidate]) -> str:
        lefts, off_mm = (
            np.array([getattr(each, what) for each in some]) for what in ("left", "me_mm")
        )
        return f"{spearman(lefts, off_mm):.2f}"

    best = {
        profile: min((c for c in found if c.profile == profile), key=lambda c: c.left).factor
        for profile in LADDER
    }
    return [
        name,
        choice.prints[0].kind.name,
        *(f"{each.me_mm:.2f} ({100 * each.left:.0f})" for each in shipped),
        rank(list(found)),
        rank(shipped),
        ", ".join(f"{factor:g}" for factor in best.values()),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Measure the sensors and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=Path, required=True, help="a folder for each family")
    parser.add_argument("--families", default=",".join(FAMILIES))
    parser.add_argument("--range", choices=("working", "final"), default="working")
    parser.add_argument("--sensors", type=int, default=2)
    options = parser.parse_args(arguments)
    rows = []
    for family in options.families.split(","):
        for number in range(options.sensors):
            stranger = FAMILIES[family](options.range, number, options.states / family)
            calibration = calibrated(stranger).calibration
            choice = chosen_prints(calibration, identify(calibration), stranger.touches())
            name = f"{family} {number}"
            if choice is None:
                rows.append([name, "no print", *("-" for _ in LADDER), "-", "-", "-"])
                continue
            rows.append(row(name, choice, candidates(stranger, calibration, choice)))
            print(rows[-1], file=sys.stderr, flush=True)
    headings = (
        "sensor",
        "print",
        *(f"{profile}: ME mm (left %)" for profile in LADDER),
        "rank, all",
        "rank, as shipped",
        f"factor that leaves least ({', '.join(LADDER)})",
    )
    print(markdown(headings, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
