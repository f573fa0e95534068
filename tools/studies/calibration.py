#!/usr/bin/env python3
"""What `calibrate` finds wrong, and what it finds wrong in good sets:
calibration-checks.md has the tables.

::

    .venv/bin/python -m tools.studies.calibration [--sensors 30] [--detect 30] [--first 8100]
        [--height 480]

Every sensor is drawn at random, with 5 references and 24 ball presses. A good set must pass without
a warning; then the study introduces one error at a time and counts the right warnings (or
refusals). An error in one press is introduced into each press in turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.quality import GRADED_PROFILE
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.cli.shared.finding_options import WITH_OPTIONS
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.parallel import workers
from tacshade_edge.sensor.frame_check import camera_drift
from tools.studies import command
from tools.studies.wrong_sets import PRESSES, good_set, rezeros, wrong_presses, wrong_sets


@dataclass(frozen=True, slots=True)
class Measured:
    """One sensor's figures: false alarms, what was found, (label, depth, agreement, grade),
    drift of good presses.
    """

    alarms: list[str]
    found: list[tuple[str, bool]]
    quality: list[tuple[str, float, float, str]]
    drifts: list[camera_drift.Drift]


def measure(task: tuple[int, bool, int]) -> Measured:
    """One sensor of a seed and image height: as a good set, and, with `detect`,
    with everything that can be wrong.
    """
    seed, detect, height_px = task
    rng = np.random.default_rng(seed)
    given = good_set(seed, height_px)
    try:
        result = given.calibrate()
    except ConfigError as error:
        return Measured([f"sensor {seed}: refused: {error}"], [], [], [])
    calibration = result.calibration
    look = camera_drift.look(
        calibration.reference_grey, calibration.geometry.disc, calibration.pitch_px
    )
    quality = []
    for sigma in (0.0, 0.3, 0.6):
        label = f"depths stated {sigma} mm off (standard deviation)" if sigma else "good sets"
        jitter = sigma * given.scale * rng.standard_normal(PRESSES)
        presses = [
            replace(p, depth_mm=max(p.depth_mm + e, 0.2))
            for p, e in zip(given.presses, jitter, strict=True)
        ]
        try:
            made = given.calibrate(presses=presses)
        except ConfigError:
            quality.append((label, np.nan, np.nan, "refused"))
            continue
        fit = made.calibration.fit
        depth_mm = (
            fit.profiles[GRADED_PROFILE].depth_mae_mm
            if fit and GRADED_PROFILE in fit.profiles
            else np.nan
        )
        agreement_mm = fit.agreement_mae_mm if fit else np.nan
        quality.append(
            (label, depth_mm / given.scale, agreement_mm / given.scale, made.quality.grade)
        )
    found = list(wrong_presses(given)) if detect else []
    found += [
        (label, any(part in said for part in wanted.split("|")))
        for label, wanted, said in (
            (*wrong_sets(given, rng), *rezeros(given, result)) if detect else ()
        )
    ]
    heard = (*result.warnings, *result.quality.advice)
    alarms = [f"sensor {seed}: {sentence(one, WITH_OPTIONS)}" for one in heard]
    drifts = [camera_drift.drift(look, press.image) for press in given.presses]
    return Measured(alarms, found, quality, drifts)


def report(measured: Sequence[Measured]) -> str:
    """The document's tables, in Markdown."""
    good = sum(bool(m.quality) for m in measured)
    alarms = [alarm for m in measured for alarm in m.alarms]
    lines = [
        (
            f"False alarms in {len(measured)} good sets ({good} calibrated, {good * PRESSES} "
            f"presses): {len(alarms)}"
        )
    ]
    lines += [f"- {alarm}" for alarm in alarms] + ["", "| what was wrong | said |", "|---|---|"]
    found: dict[str, list[bool]] = {}
    for label, hit in (pair for m in measured for pair in m.found):
        found.setdefault(label, []).append(hit)
    lines += [f"| {label} | {sum(hits)} of {len(hits)} |" for label, hits in found.items()]
    lines += [
        "",
        (
            "| presses | depth error mm: median, 90 %, worst | agreement_mae_mm likewise | good, "
            "fair, poor, refused |"
        ),
        "|---|---|---|---|",
    ]
    quality = [row for m in measured for row in m.quality]
    for label in dict.fromkeys(row[0] for row in quality):
        rows = [row for row in quality if row[0] == label]
        cells = [label]
        for column in (1, 2):
            quantiles = np.nanquantile([row[column] for row in rows], [0.5, 0.9, 1.0])
            cells.append(", ".join(f"{v:.2f}" for v in quantiles))
        grades = [
            sum(row[3] == grade for row in rows) for grade in ("good", "fair", "poor", "refused")
        ]
        cells.append(", ".join(map(str, grades)))
        lines.append(f"| {' | '.join(cells)} |")
    all_drifts = [d for m in measured for d in m.drifts]
    seen = [d for d in all_drifts if d.still_part > 0]
    lines += [
        "",
        (
            f"Drift of good presses: measured in {len(seen)} of {len(all_drifts)}; the most: shift "
            f"{max(d.shift_px for d in seen):.2f} px, with turn and zoom "
            f"{max(d.moved_px for d in seen):.2f} px, light {min(d.light for d in seen):.3f} to "
            f"{max(d.light for d in seen):.3f}, uneven {max(d.uneven for d in seen):.3f}, contrast "
            f"{min(d.contrast for d in seen):.2f}"
        ),
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description="What `calibrate` detects, and its false alarms.")
    parser.add_argument("--sensors", type=int, default=30)
    parser.add_argument(
        "--detect", type=int, default=30, help="so many of them are also made wrong (30)"
    )
    parser.add_argument("--first", type=int, default=8100, help="seed of the first sensor")
    parser.add_argument("--height", type=int, default=480, help="of the images, px")
    args = parser.parse_args()
    tasks = [(args.first + k, k < args.detect, args.height) for k in range(args.sensors)]
    with command.folder_for(parser, None), workers() as pool:
        print(report(list(pool.map(measure, tasks))))


if __name__ == "__main__":
    main()
