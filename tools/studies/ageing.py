"""Ageing: what wear costs, whether its kind is named, how often a sound sensor is accused.

::

    .venv/bin/python -m tools.studies.ageing errors|years [--sensors N] [--final]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from tacshade_edge.calibration.ageing.appearance import appearance
from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.calibration.reference.references import with_reference
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.studies.evaluate.score import score
from tacshade_edge.lab.studies.evaluate.work import (
    NULL_NOISE,
    PRESSES,
    Case,
    SensorName,
    one_thread,
    press_cases,
    reconstructor,
    scenes,
)
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.types import Calibration, Frame
from tools.studies import command
from tools.studies.ageing_years import SoundRow, YearRow, tables, years_of
from tools.testbed.simulator.days import calibrated_model
from tools.testbed.simulator.families import FINAL_SEED
from tools.testbed.simulator.wear import Wear, WornSensor

Row = TypeVar("Row")
OBJECTS = ("ball", "cube", "large_crescent")
SCENES_STEP = 3
PROFILES = ("balanced", "accurate")
WEARS: dict[str, tuple[Wear, ...]] = {
    "none": (Wear(),),
    "light, all": tuple(Wear(dimmed=part) for part in (0.3, 0.5, 0.6)),
    "light, one side": (Wear(dimmed_side=0.6),),
    "markers fade": tuple(Wear(faded=part) for part in (0.4, 0.6, 0.8)),
    "pins bend": tuple(
        Wear(bent_mm=1.0, bent_radius_mm=radius_mm) for radius_mm in (1.5, 2.5, 4.0)
    ),
    "gel leaks": tuple(Wear(leaked_mm=mm) for mm in (0.1, 0.2, 0.3)),
}


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """The errors of one profile on one worn sensor, with a reference of the new sensor and with
    one of the worn one, and what was seen of the wear.
    """

    wear: str
    size: int
    sensor: int
    profile: str
    stale_mm: float
    renewed_mm: float
    refused: int
    frames: int
    white: float
    sunk_mm: float
    bent_part: float


def unless_refused(job: Callable[[int], Sequence[Row]], seed: int) -> Sequence[Row]:
    """What a job finds on a sensor; nothing on one that `calibrate` refuses."""
    try:
        return job(seed)
    except ConfigError:
        return ()


def errors_of(seed: int) -> list[ErrorRow]:
    """The errors of each wear on a sensor."""
    with one_thread():
        model, calibration = calibrated_model(seed, PRESSES)
        return [
            row
            for name, wears in WEARS.items()
            for size, wear in enumerate(wears)
            for row in _errors(
                name, size, seed, calibration, WornSensor(model, _placed(wear, seed))
            )
        ]


def _placed(wear: Wear, seed: int) -> Wear:
    return replace(wear, seed=seed)


def _errors(
    name: str, size: int, seed: int, calibration: Calibration, sensor: WornSensor
) -> list[ErrorRow]:
    images = [sensor.frame((), NULL_NOISE + k).image for k in range(10)]
    seen = appearance(calibration, images)
    greys = [greyscale.to_grey(image) for image in images]
    renewed = with_crc(with_reference(replace(calibration, crc32=0), greys))
    cases = [
        case
        for object_name in OBJECTS
        for case in press_cases(
            SensorName("tacshade", seed),
            sensor,
            scenes(sensor.model, seed, object_name)[::SCENES_STEP],
        )
    ]
    rows = []
    for profile in PROFILES:
        stale, refused = _judged(calibration, profile, cases)
        rows.append(
            ErrorRow(
                name,
                size,
                seed,
                profile,
                stale,
                _judged(renewed, profile, cases)[0],
                refused,
                len(cases),
                *((math.nan,) * 3 if seen is None else (seen.white, seen.sunk_mm, seen.bent_part)),
            )
        )
    return rows


def _judged(calibration: Calibration, profile: str, cases: Sequence[Case]) -> tuple[float, int]:
    """The mean ME of a profile in mm, a missed or refused press counted with its depth; and how
    many were refused.
    """
    one = reconstructor(calibration, profile)
    errors_mm, refused = [], 0
    for case in cases:
        found = one.step(Frame(0, 0, 0, case.image))
        me_mm = score(case.label, case.truth, found).me_mm
        refused += not found.valid
        errors_mm.append(case.truth.depth_max_mm if math.isnan(me_mm) else me_mm)
    return float(np.mean(errors_mm)), refused


def error_table(rows: Sequence[ErrorRow]) -> str:
    """Mean errors by wear and size, and beside those of the new sensors."""
    lines = []
    for name, wears in WEARS.items():
        for size, wear in enumerate(wears):
            for profile in PROFILES:
                some = [r for r in rows if (r.wear, r.size, r.profile) == (name, size, profile)]
                new = {r.sensor: r for r in rows if (r.wear, r.profile) == ("none", profile)}
                stale, renewed = (
                    np.mean([getattr(r, key) / getattr(new[r.sensor], key) for r in some])
                    for key in ("stale_mm", "renewed_mm")
                )
                lines.append(
                    (
                        name,
                        _amount(wear),
                        f"{100 * (1 - math.exp(float(np.mean([r.white for r in some])))):.0f} %",
                        f"{100 * np.mean([r.bent_part for r in some]):.1f} %",
                        f"{np.mean([r.sunk_mm for r in some]):.2f}",
                        profile,
                        f"{np.mean([r.renewed_mm for r in some]):.3f}",
                        f"{renewed:.2f}",
                        f"{stale:.2f}",
                        f"{sum(r.refused for r in some)} of {sum(r.frames for r in some)}",
                    )
                )
    header = (
        "wear",
        "amount",
        "white lost",
        "pattern changed",
        "sunk mm",
        "profile",
        "ME mm",
        "beside new",
        "old reference",
        "refused then",
    )
    return markdown(header, lines)


def _amount(wear: Wear) -> str:
    if wear.leaked_mm:
        return f"{wear.leaked_mm:.1f} mm"
    if wear.bent_mm:
        return f"within {wear.bent_radius_mm:.1f} mm"
    part = wear.dimmed or wear.dimmed_side or wear.faded
    return f"{100 * part:.0f} %" if part else ""


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="What ages, and what is said of it.")
    parser.add_argument("what", choices=("errors", "years"))
    parser.add_argument("--sensors", type=int, default=4, metavar="N")
    final = "sensors kept for the figures of a release: not to be looked at while working"
    parser.add_argument("--final", action="store_true", help=final)
    command.add_output(parser)
    args = parser.parse_args(words)
    first = FINAL_SEED + 400 if args.final else 400
    seeds = range(first, first + args.sensors)
    jobs: dict[str, tuple[Callable[[int], Sequence[Any]], Callable[[Any], str], dict[str, Any]]] = {
        "errors": (errors_of, error_table, {"": ErrorRow}),
        "years": (years_of, tables, {"worn": YearRow, "sound": SoundRow}),
    }
    job, table, kinds = jobs[args.what]

    def work(pool: Workers, report: Report) -> list[Any]:
        made = reported_map(partial(unless_refused, job), seeds, pool, report, "sensors studied")
        return [row for rows in made for row in rows]

    command.run(parser, args, f"ageing_{args.what}", work, table, kinds)


if __name__ == "__main__":
    main()
