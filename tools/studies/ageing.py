"""Ageing: what wear costs, whether its kind is named, how often a sound sensor is accused.

::

    .venv/bin/python -m tools.studies.ageing errors|kinds|years [--sensors N] [--final]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.calibration.reference.ageing import KINDS, History, Kind, judge
from tacshade_edge.calibration.reference.appearance import appearance
from tacshade_edge.calibration.reference.references import with_reference
from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.studies.evaluate.score import score
from tacshade_edge.lab.studies.evaluate.work import (
    NULL_NOISE,
    PRESSES,
    REFERENCES,
    Case,
    SensorName,
    calibrated_sensor,
    one_thread,
    press_cases,
    reconstructor,
    scenes,
)
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.types import F64, Calibration, Frame
from tools.studies import command
from tools.testbed.simulator.days import FIRST_DAY, YEAR, Day, days_of, history_of
from tools.testbed.simulator.families import FINAL_SEED
from tools.testbed.simulator.wear import Wear, WornSensor

SIZE = (240, 320)
OBJECTS = ("ball", "cube", "large_crescent")
SCENES_STEP = 2
PROFILES = ("balanced", "accurate")
WEARS: dict[str, tuple[Wear, ...]] = {
    "none": (Wear(),),
    "light, all": tuple(Wear(dimmed=part) for part in (0.2, 0.4, 0.5, 0.6)),
    "light, one side": tuple(Wear(dimmed_side=part) for part in (0.3, 0.6)),
    "markers fade": tuple(Wear(faded=part) for part in (0.2, 0.4, 0.6, 0.8)),
    "pins bend": tuple(
        Wear(bent_mm=1.0, bent_radius_mm=radius_mm) for radius_mm in (1.5, 2.5, 4.0, 6.0)
    ),
    "gel leaks": tuple(Wear(leaked_mm=mm) for mm in (0.1, 0.2, 0.3, 0.5)),
}
LASTING: dict[str, tuple[Kind | None, Callable[[float], Wear]]] = {
    "nothing": (None, lambda part: Wear()),
    "light, all": ("light", lambda part: Wear(dimmed=0.55 * part)),
    "light, one side": ("light", lambda part: Wear(dimmed_side=0.7 * part)),
    "markers": ("markers", lambda part: Wear(faded=0.7 * part)),
    "pins": ("pins", lambda part: Wear(bent_mm=1.0, bent_radius_mm=0.5 + 3.5 * part)),
    "gel": ("gel", lambda part: Wear(leaked_mm=0.4 * part)),
}
"""The kind that should be named, and the wear after a part of a year."""
STEPS = 12  # in which wear grows over the year
EVERY = 4  # of a year's looks, for the time that drawn pictures take
DRAWN = 20  # further years for each of pictures


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


@dataclass(frozen=True, slots=True)
class YearRow:
    """A year of one sensor: what was named at its end, when something was named first, and what was
    forecast then; days are counted from the year's first.
    """

    wear: str
    sensor: int
    named: str
    first: str
    first_day: float
    forecast_day: float
    limit_day: float


@dataclass(frozen=True, slots=True)
class SoundRow:
    """A year of a sound sensor: its looks, and how often something was named anew."""

    how: str
    sensor: int
    looks: int
    alarms: int
    kinds: str


def _calibrated(seed: int, presses: int) -> tuple[SensorModel, Calibration]:
    model = random_model(seed, *SIZE)
    return model, calibrated_sensor(
        WornSensor(model, Wear()), seed, REFERENCES, presses
    ).calibration


def errors_of(seed: int) -> list[ErrorRow]:
    """The errors of each wear on a sensor."""
    with one_thread():
        model, calibration = _calibrated(seed, PRESSES)
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


def years_of(seed: int) -> list[YearRow]:
    """A year of each wear on a sensor."""
    with one_thread():
        model, calibration = _calibrated(seed, 0)
        return [_year(name, model, calibration, seed) for name in LASTING]


def _year(name: str, model: SensorModel, calibration: Calibration, seed: int) -> YearRow:
    _, worn = LASTING[name]

    def wear(day: int) -> Wear:
        return _placed(worn(round(STEPS * day / YEAR) / STEPS), seed)

    first, first_day, forecast_day, limit_day = "", math.nan, math.nan, math.nan
    named: list[str] = []
    days = list(days_of(seed, YEAR))[::EVERY]
    for history in history_of(model, calibration, seed, days, wear):
        wears = [each for each in judge(history) if each.named]
        named, day = [each.kind for each in wears], int(history.days[-1]) - FIRST_DAY
        if wears and not first:
            first, first_day = "+".join(named), day
            if wears[0].limit_day is not None:
                forecast_day = wears[0].limit_day - FIRST_DAY
        if math.isnan(limit_day) and any(each.beyond for each in wears):
            limit_day = day
    return YearRow(name, seed, "+".join(named), first, first_day, forecast_day, limit_day)


def sound_of(seed: int) -> list[SoundRow]:
    """A year of a sound sensor by its pictures, and further ones whose looks are drawn."""
    with one_thread():
        model, calibration = _calibrated(seed, 0)
        days = list(days_of(seed, YEAR))
        *_, year = history_of(model, calibration, seed, days, lambda _: Wear())
        rows = [_sound("pictures", seed, year)]
        # What each difference of a day does to a look, and what it leaves, which is drawn again.
        known = [day for day in days if day.number in year.days]
        does = np.linalg.lstsq(_design(known), year.looks, rcond=None)[0]
        left = year.looks - _design(known) @ does
        rng = np.random.default_rng((seed, 51))
        for k in range(DRAWN):
            others = list(days_of(seed + 100_000 * (k + 1), YEAR))
            looks = _design(others) @ does + left[rng.integers(0, len(left), len(others))]
            numbers = np.array([day.number for day in others], np.int32)
            rows.append(_sound("drawn", seed, History(numbers, looks.astype(np.float32))))
        return rows


def _design(days: Sequence[Day]) -> F64:
    """What differs on days, a row for each."""
    rows = [
        (1, math.log(day.light), day.swollen_mm, day.zoom - 1, day.dirty, day.loaded)
        for day in days
    ]
    return np.array(rows, np.float64)


def _sound(how: str, seed: int, year: History) -> SoundRow:
    """How often a year's days name something anew."""
    before, kinds, alarms = set[Kind](), set[Kind](), 0
    for k in range(1, len(year.days) + 1):
        wears = judge(History(year.days[:k], year.looks[:k]))
        named = {each.kind for each in wears if each.named}
        alarms += bool(named - before)
        kinds |= named
        before = named
    return SoundRow(how, seed, len(year.days), alarms, "+".join(sorted(kinds)))


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


def year_table(rows: Sequence[YearRow]) -> str:
    """What was named at the year's end, by the true wear, and when."""
    lines = []
    for name, (kind, _) in LASTING.items():
        some = [row for row in rows if row.wear == name]
        named = [sum(row.named == each for row in some) for each in (*KINDS, "")]
        right = [row for row in some if row.first == kind]
        off = [
            abs(row.forecast_day - row.limit_day)
            for row in right
            if not math.isnan(row.forecast_day - row.limit_day)
        ]
        ahead = [row.limit_day - row.first_day for row in right if not math.isnan(row.limit_day)]
        lines.append(
            (
                name,
                *(str(count) for count in (*named, len(some) - sum(named))),
                f"{len(right)} of {len(some)}" if kind else "",
                f"{np.median(ahead):.0f}" if ahead else "",
                f"{np.median(off):.0f}" if off else "",
            )
        )
    header = (
        "true wear",
        *KINDS,
        "nothing",
        "several",
        "right at first",
        "days ahead",
        "forecast off, days",
    )
    return markdown(header, lines)


def sound_table(rows: Sequence[SoundRow]) -> str:
    """How often sound sensors were accused."""
    lines = []
    for how in ("pictures", "drawn"):
        some = [row for row in rows if row.how == how]
        lines.append(
            (
                how,
                str(len({row.sensor for row in some})),
                str(len(some)),
                str(sum(row.looks for row in some)),
                str(sum(row.alarms for row in some)),
                str(max(row.alarms for row in some)),
                *(str(sum(kind in row.kinds.split("+") for row in some)) for kind in KINDS),
            )
        )
    header = (
        "looks",
        "sensors",
        "years",
        "days",
        "false alarms",
        "most in a year",
        *(f"years with {kind}" for kind in KINDS),
    )
    return markdown(header, lines)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="What ages, and what is said of it.")
    parser.add_argument("what", choices=("errors", "kinds", "years"))
    parser.add_argument("--sensors", type=int, default=4, metavar="N")
    final = "sensors kept for the figures of a release: not to be looked at while working"
    parser.add_argument("--final", action="store_true", help=final)
    command.add_output(parser)
    args = parser.parse_args(words)
    first = FINAL_SEED + 400 if args.final else 400
    seeds = range(first, first + args.sensors)
    jobs: dict[str, tuple[Callable[[int], Sequence[Any]], Callable[[Any], str], type[Any]]] = {
        "errors": (errors_of, error_table, ErrorRow),
        "kinds": (years_of, year_table, YearRow),
        "years": (sound_of, sound_table, SoundRow),
    }
    job, table, kind = jobs[args.what]

    def work(pool: Workers, report: Report) -> list[Any]:
        made = reported_map(job, seeds, pool, report, "sensors studied")
        return [row for rows in made for row in rows]

    command.run(parser, args, f"ageing_{args.what}", work, table, {"": kind})


if __name__ == "__main__":
    main()
