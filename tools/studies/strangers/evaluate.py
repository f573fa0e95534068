"""What the shipped networks and ``calibrate --fit`` give on strangers (README.md).

::

    .venv/bin/python -m tools.studies.strangers.evaluate --states STATES
        [--families third,layered,oblate] [--range working] [--sensors 4]
        [--first 0] [--ways none,touches,balls] [--folder FOLDER]

STATES has a folder of solved states for each family. A case is a sensor and what a fit knows of it
(`WAYS`); each is measured in its own process, one after another. With a folder, the study keeps
each case's results there, and does not measure the case again until the program changes.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.calibration.calibrate import CalibrationResult
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.studies.evaluate.score import Label, score
from tacshade_edge.lab.studies.evaluate.work import reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.depth.sigma import INTERVAL_90
from tacshade_edge.sensor.profiles import LADDER
from tacshade_edge.types import U8, Calibration, Frame, Reconstruction
from tools.fingerprint import fingerprint
from tools.studies import command
from tools.studies.strangers.families import FAMILIES
from tools.studies.strangers.sensor import Seen, Stranger, calibrated

PROGRAM = "tools.studies.strangers.evaluate"
SHIPPED = "shipped"
WAYS = ("none", "touches", "balls")
"""What a fit knows beside the references: nothing, touches without labels, or presses of balls."""


@dataclass(frozen=True, slots=True)
class Case:
    """A sensor, and how its user calibrates it: `SHIPPED` or one of `WAYS`."""

    family: str
    range_name: str
    number: int
    way: str

    def sensor(self, states: Path) -> Stranger:
        """Make the sensor."""
        return FAMILIES[self.family](self.range_name, self.number, states / self.family)

    def file(self, folder: Path) -> Path:
        """Where its results are kept."""
        return folder / f"{self.family}-{self.range_name}-{self.number}-{self.way}.json"


@dataclass(frozen=True, slots=True)
class Judged:
    """One frame by one profile; `me_mm` and `held_pct` are NaN if no contact was found.

    `held_pct` is the share of the cells found in contact whose 90 % interval holds the true height.
    """

    profile: str
    object: str
    dragged: bool
    me_mm: float
    held_pct: float


def held_pct(seen: Seen, result: Reconstruction) -> float:
    """The share of cells in contact, with a known true height, that the 90 % interval holds."""
    if not result.contact or result.sigma_mm is None:
        return math.nan
    contact = result.height.contact
    true_mm = seen.truth.sampled(seen.truth.height_mm, result.height)[contact]
    off_mm = np.abs(result.height.height_mm[contact] - true_mm)
    known = np.isfinite(off_mm)
    held = off_mm[known] <= INTERVAL_90 * result.sigma_mm[contact][known]
    return 100 * float(held.mean()) if known.any() else math.nan


def judge(stranger: Stranger, calibration: Calibration) -> list[Judged]:
    """Judge every profile with a network on Table I's objects."""
    made = {profile: reconstructor(calibration, profile) for profile in LADDER}
    rows = []
    for seen in stranger.judged():
        for profile, each in made.items():
            result = each.step(Frame(0, 0, 0, seen.image))
            scored = score(Label("stranger", seen.object_name), seen.truth, result)
            held = held_pct(seen, result)
            rows.append(Judged(profile, seen.object_name, seen.dragged, scored.me_mm, held))
    return rows


def fitted(result: CalibrationResult, touches: Sequence[U8]) -> tuple[Calibration, list[str]]:
    """Fit the networks; a refused fit leaves the shipped ones and says why."""
    from tacshade_edge.lab.fitting.fit import fit  # PyTorch is needed only here

    try:
        made = fit(result.calibration, result.presses, lambda _: None, touches=touches)
    except ConfigError as error:
        return result.calibration, [str(error)]
    return made.calibration, [*made.found, *(report.line for report in made.networks)]


def measured(states: Path, case: Case) -> dict[str, Any]:
    """Calibrate, fit and judge a case. Raises FileNotFoundError (not solved)."""
    stranger = case.sensor(states)
    began_s = time.monotonic()
    said: list[str] = []
    try:
        result = calibrated(stranger, stranger.balls() if case.way == "balls" else ())
    except ConfigError as error:
        # Its user goes on without the presses that `calibrate` refuses.
        calibration, said = calibrated(stranger, ()).calibration, [str(error)]
    else:
        calibration = result.calibration
        if case.way != SHIPPED:
            touches = stranger.touches() if case.way == "touches" else ()
            calibration, said = fitted(result, touches)
    took_s = time.monotonic() - began_s
    rows = [asdict(row) for row in judge(stranger, calibration)]
    return {"fit_s": took_s, "kept": sorted(calibration.fitted), "said": said, "rows": rows}


def of_cases(
    cases: Sequence[Case], states: Path, folder: Path | None
) -> Iterator[tuple[Case, dict[str, Any]]]:
    """Each case's results, measured now or kept."""
    spawn, own = multiprocessing.get_context("spawn"), fingerprint([PROGRAM])
    with ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as pool:
        for case in cases:
            file = case.file(folder) if folder else None
            if file and file.exists() and (found := json.loads(file.read_text()))["program"] == own:
                yield case, found
                continue
            found = {"program": own, **pool.submit(partial(measured, states), case).result()}
            if file:
                file.write_text(json.dumps(found))
            yield case, found


Results = Mapping[Case, list[Judged]]


def mean(rows: Sequence[Judged], value: str) -> float:
    """The mean over frames with a contact; NaN if there are none."""
    values = [getattr(row, value) for row in rows if not math.isnan(getattr(row, value))]
    return float(np.mean(values)) if values else math.nan


def lines(family: str, ways: Sequence[str], results: Results) -> list[list[str]]:
    """Lines of a family's table, one for each way and profile."""
    made = []
    for way in (SHIPPED, *ways):
        for profile in LADDER:
            cells = [family, way, profile]
            of_way = {case: rows for case, rows in results.items() if case.family == family}
            for dragged in (False, True):
                cells += _figures(of_way, way, profile, dragged)
            made.append(cells)
    return made


def _figures(results: Results, way: str, profile: str, dragged: bool) -> list[str]:
    """ME, its ratio to that as shipped in the mean and on the worst sensor, missed frames,
    and held intervals.
    """

    def of(case_way: str) -> dict[int, list[Judged]]:
        return {
            case.number: [r for r in rows if (r.profile, r.dragged) == (profile, dragged)]
            for case, rows in results.items()
            if case.way == case_way
        }

    before, after = of(SHIPPED), of(way)
    me_mm = {number: mean(rows, "me_mm") for number, rows in after.items()}
    shipped_mm = {number: mean(before[number], "me_mm") for number in after}
    every = [row for rows in after.values() for row in rows]
    ratio = np.mean(list(me_mm.values())) / np.mean(list(shipped_mm.values()))
    worst = max(me_mm[number] / shipped_mm[number] for number in me_mm)
    missed = sum(math.isnan(row.me_mm) for row in every)
    return [
        f"{np.mean(list(me_mm.values())):.3f}",
        f"{ratio:.2f}",
        f"{worst:.2f}",
        f"{missed} of {len(every)}",
        f"{mean(every, 'held_pct'):.0f}",
    ]


HEADINGS = tuple(
    f"{what} {figure}"
    for what in ("pressed", "dragged")
    for figure in ("ME mm", "of shipped", "worst sensor", "missed", "in 90 %")
)


def main(arguments: list[str] | None = None) -> int:
    """Measure the cases and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=Path, required=True, help="a folder for each family")
    parser.add_argument("--families", default=",".join(FAMILIES))
    parser.add_argument("--range", choices=("working", "final"), default="working")
    parser.add_argument("--sensors", type=int, default=4)
    parser.add_argument(
        "--first", type=int, default=0, help="number of the first sensor, which nobody opened"
    )
    parser.add_argument("--ways", default=",".join(WAYS), help="of a fit; empty: none is fitted")
    parser.add_argument("--folder", type=Path, help="keeps what was measured, a file for each case")
    options = parser.parse_args(arguments)
    families, ways = options.families.split(","), [way for way in options.ways.split(",") if way]
    for given, known in ((families, tuple(FAMILIES)), (ways, WAYS)):
        for name in given:
            if name not in known:
                parser.error(f"found {name!r}, expected one of {', '.join(known)}")
    cases = [
        Case(family, options.range, number, way)
        for way in (SHIPPED, *ways)
        for family in families
        for number in range(options.first, options.first + options.sensors)
    ]
    results = {}
    try:
        with command.folder_for(parser, options.folder):
            for case, found in of_cases(cases, options.states, options.folder):
                name = f"{case.family} {case.number} {case.way}"
                print(f"{name}: {found['fit_s']:.0f} s", file=sys.stderr, flush=True)
                results[case] = [Judged(**row) for row in found["rows"]]
    except FileNotFoundError as error:
        print(f"{error.filename} is missing: solve the family first (README.md)", file=sys.stderr)
        return 1
    rows = [line for family in families for line in lines(family, ways, results)]
    print(markdown(["family", "fit", "profile", *HEADINGS], rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
