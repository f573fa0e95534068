#!/usr/bin/env python3
"""What ``calibrate --fit`` is worth: simulated sensors, fitted to presses,
on objects that were not pressed.

::

    .venv/bin/python -m tools.studies.fit [--cases other:31/none,other:31/balls] [--folder FOLDER]

A case is a sensor and what the fit knows of it (`WAYS`): references and 40 presses, references
alone (``/none``), or what a user does not know: the exact print and mechanics, or wrong ones. The
presses are of balls of three sizes, flat ends of two, a square and a lying bar, or of the balls
alone, 0.6 to 4.5 mm deep; the stated presses are off by 0.05 mm in place and 0.03 mm in depth (one
standard deviation each). Networks that the fit does not keep are judged as well. Each case runs in
its own process, one after another, as times are measured; on a cluster (``--cluster ADDRESS``),
many fits run at the same time, and their times and memory are left out. With a folder, the study
keeps each case's results and its fitted calibration there, and does not measure the case again
until the program changes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import tacshade_edge
from tacshade_edge.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.cli.shared.options import add_cluster
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.lab.fitting.fit import fit
from tacshade_edge.lab.fitting.identify import identify
from tacshade_edge.lab.fitting.prints import PARAMETERS
from tacshade_edge.lab.fitting.twin import Mechanics
from tacshade_edge.lab.parallel import reported_map, workers
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.studies.evaluate.work import (
    REFERENCE_NOISE,
    PressedSensor,
)
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.inference.network import load_networks, make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, LADDER, PROFILES
from tacshade_edge.types import Calibration, Frame
from tools.studies import command
from tools.studies.fit_presses import pressed
from tools.studies.fit_scores import DRAG_MM, DRAGGED_MM, FIGURES, Judged, changes, judge, of_sensor
from tools.testbed.simulator.families import sensor_name

CASES = (
    "5/none,11/none,21/none,other:31/none,other:32/none,other:33/none,"
    "5,11/balls,21/balls,other:31,other:32/balls,other:33/balls"
)


@dataclass(frozen=True, slots=True)
class Way:
    """What a fit knows.

    `presses`: "mixed", "balls" or "none". `pin_length`: its factor in an otherwise exact drawing,
    without which the fit finds the print. `decay`: the factor on the skin's decay length, which is
    known with the friction; without it, neither is.
    """

    presses: str
    pin_length: float | None = None
    decay: float | None = None


WAYS = {
    "": Way("mixed"),
    "none": Way("none"),
    "balls": Way("balls"),
    "drawing": Way("balls", 1.0),
    "exact": Way("none", 1.0, 1.0),
    "long": Way("none", 1.2, 1.0),
    "short": Way("none", 0.8, 1.0),
    "slow": Way("none", 1.0, 1.5),
    "steep": Way("none", 1.0, 0.5),
}
REFERENCES = 5
ROUNDS, STARTS = 40, 5
"""Numbers of frames and starts behind a reported median."""


def calibrated(sensor: PressedSensor, presses: list[KnownPress]) -> CalibrationResult:
    """A user's calibration without a fit."""
    model = sensor.model
    stated = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
    )
    references = [sensor.frame((), REFERENCE_NOISE + k).image for k in range(REFERENCES)]
    return calibrate(stated, references, presses, networks=load_networks())


def cost(
    sensor: PressedSensor, calibrations: Mapping[str, Calibration]
) -> dict[str, dict[str, float]]:
    """File size, start-up (file, weights, first frame) and time per frame of the default profile,
    measured in turns.
    """
    press = Press(OBJECTS["ball"](), depth_mm=3.0)
    frame = Frame(0, 0, 0, sensor.frame((press,), 1).image)
    starts_s: dict[str, list[float]] = {what: [] for what in calibrations}
    frames_s: dict[str, list[float]] = {what: [] for what in calibrations}
    made = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = {what: Path(folder) / f"{what}.npz" for what in calibrations}
        for what, calibration in calibrations.items():
            calibration_file.save(paths[what], calibration)
        for _ in range(STARTS):
            for what, path in paths.items():
                began_s = time.perf_counter()
                made[what] = make_reconstructor(calibration_file.load(path), PROFILES[DEFAULT])
                made[what].step(frame)
                starts_s[what].append(time.perf_counter() - began_s)
        sizes_kb = {what: path.stat().st_size / 1024 for what, path in paths.items()}
    for _ in range(ROUNDS):
        for what, reconstructor in made.items():
            began_s = time.perf_counter()
            reconstructor.step(frame)
            frames_s[what].append(time.perf_counter() - began_s)
    return {
        what: {
            "file_kb": sizes_kb[what],
            "start_ms": 1e3 * float(np.median(starts_s[what])),
            "frame_ms": 1e3 * float(np.median(frames_s[what])),
        }
        for what in calibrations
    }


def drawing(model: SensorModel) -> dict[str, float]:
    """The sizes of the sensor's print, as SENSOR.yaml states them."""
    sizes = {
        key.replace("_pitches", "_mm"): getattr(model, key) * model.pitch_mm for key in PARAMETERS
    }
    return {"pitch_mm": model.pitch_mm, **sizes}


def sizes_off_pct(calibration: Calibration, model: SensorModel) -> dict[str, float]:
    """By how much the likeliest print in the reference is too large or too small."""
    best = identify(calibration)[0]
    return {
        key.removeprefix("pin_").removesuffix("_pitches").replace("_", " "): 100
        * (value * best.base.pitch_mm / (getattr(model, key) * model.pitch_mm) - 1)
        for key, value in zip(PARAMETERS[:3], best.values[:3], strict=True)
    }


def measured(case: str) -> tuple[dict[str, Any], bytes]:
    """Calibrate, fit and judge a case; return the file of the calibration that the user would have,
    too.
    """
    text, _, known = case.partition("/")
    name, way = sensor_name(text), WAYS[known]
    sensor = name.make()
    model = sensor.model
    result = calibrated(
        sensor,
        []
        if way.presses == "none"
        else pressed(sensor, name.seed or 0, balls=way.presses == "balls"),
    )
    stated, mechanics = {}, None
    if way.pin_length:
        stated = drawing(
            replace(model, pin_length_pitches=way.pin_length * model.pin_length_pitches)
        )
    if way.decay:
        decay_mm = way.decay * model.skin_decay_mm
        mechanics = Mechanics((decay_mm, decay_mm), (model.friction, model.friction))
    began_s = time.monotonic()
    fitted = fit(result.calibration, result.presses, lambda _: None, stated, mechanics=mechanics)
    fit_s = time.monotonic() - began_s
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "calibration.npz"
        calibration_file.save(file, fitted.calibration)
        content = file.read_bytes()
    calibrations = {
        "shipped": result.calibration,
        "fitted": replace(fitted.calibration, fitted=dict(fitted.trained)),
    }
    figures = {
        "fit_s": fit_s,
        "memory_mb": memory_mb,
        "found": fitted.found,
        "sizes_off_pct": sizes_off_pct(result.calibration, sensor.model),
        "networks": [asdict(report) for report in fitted.networks],
        "reports": {name: name in fitted.calibration.fitted for name in LADDER},
        "cost": cost(sensor, calibrations),
        "rows": [asdict(row) for row in judge(name, sensor, calibrations)],
    }
    return figures, content


def program() -> str:
    """A hash of the measured program."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    package = Path(tacshade_edge.__file__).parent
    for room in ("core", "fitting", "simulator", "inference"):
        for path in sorted((package / room).rglob("*")):
            if (
                path.is_file() and path.parent.name != "__pycache__"
            ):  # which also holds numba's code
                digest.update(path.read_bytes())
    return digest.hexdigest()


def kept_files(folder: Path, case: str) -> tuple[Path, Path]:
    """The files that keep a case's results and its calibration."""
    stem = case.replace(":", "_").replace("/", "_")
    return folder / f"{stem}.json", folder / f"{stem}.npz"


def known_results(folder: Path | None, case: str, timed: bool) -> dict[str, Any] | None:
    """A case's results if this program measured them before; with times, if they are `timed`."""
    path = kept_files(folder, case)[0] if folder else None
    if path is None or not path.exists():
        return None
    found: dict[str, Any] = json.loads(path.read_text())
    usable = found["program"] == program() and (found.get("timed", True) or not timed)
    return found if usable else None


def of_cases(
    cases: Sequence[str], folder: Path | None, cluster: str | None
) -> Iterator[dict[str, Any]]:
    """Each case's results, measured now or kept."""
    timed = cluster is None
    found = {case: known_results(folder, case, timed) for case in cases}
    missing = [case for case in cases if found[case] is None]
    spawn = multiprocessing.get_context("spawn")
    here = ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1)
    with here if timed else workers(cluster) as pool:
        made = reported_map(measured, missing, pool, Progress(), "fits")
        for case in cases:
            known = found[case]
            if known is None:
                figures, calibration = next(made)
                known = {"program": program(), "timed": timed, **figures}
                keep(folder, case, known, calibration)
            yield known


def keep(folder: Path | None, case: str, results: Mapping[str, Any], calibration: bytes) -> None:
    """Write a case's results and its calibration into the folder, if there is one."""
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    path, beside = kept_files(folder, case)
    beside.write_bytes(calibration)
    path.write_text(json.dumps(results))


def main() -> None:
    """Fit and judge every case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--cases",
        default=CASES,
        help="sensors, with /balls for balls alone or /none for no presses",
    )
    parser.add_argument("--folder", type=Path, help="keeps what was measured, a file for each case")
    add_cluster(parser)
    args = parser.parse_args()
    with command.folder_for(parser, args.folder):
        report(args.cases.split(","), args.folder, args.cluster)


def report(cases: Sequence[str], folder: Path | None, cluster: str | None) -> None:
    """Measure and print the tables."""
    sensors, costs, judged_cases, prints = [], [], [], []
    for case, found in zip(cases, of_cases(cases, folder, cluster), strict=True):
        print(f"{case}: fitted in {found['fit_s']:.0f} s", file=sys.stderr, flush=True)
        rows = [Judged(**row) for row in found["rows"]]
        judged_cases.append((found["reports"], rows))
        sensors += of_sensor(case, found["reports"], rows)
        sizes: dict[str, float] = found["sizes_off_pct"]
        prints.append([case, *(f"{off:+.0f}" for off in sizes.values())])
        both = [found["cost"]["shipped"], found["cost"]["fitted"]]
        cells = [
            f"{each[key]:.{digits}f}"
            for key, digits in (("file_kb", 0), ("start_ms", 0), ("frame_ms", 1))
            for each in both
        ]
        costs.append([case, f"{found['fit_s']:.0f}", f"{found['memory_mb']:.0f}", *cells])

    def pairs(*names: str) -> list[str]:
        return [f"{name} {what}" for name in names for what in ("shipped", "fitted")]

    print(
        "ME after the fit over ME before, of objects that were not pressed; a fit that is not "
        "kept counts as 1.00\n"
    )
    of_each = [
        f"{judged} {what}"
        for judged in ("pressed", "dragged", "half of each", "6 mm deep")
        for what in ("mean", "worst")
    ]
    print(markdown(["method", "kept", *of_each], changes(judged_cases)))
    print(f"\nME mm of each sensor, dragged by {DRAG_MM:g} mm, {DRAGGED_MM:g} mm deep\n")
    print(markdown(["sensor", "method", "kept", *pairs(*FIGURES)], sensors))
    print("\nThe print that the reference shows, off by %\n")
    print(markdown(["sensor", *sizes], prints))
    if cluster is not None:  # other fits ran at the same time
        return
    print(f"\nThe fit of all profiles; file, start and a frame of `{DEFAULT}`\n")
    print(
        markdown(["sensor", "fit s", "memory MB", *pairs("file kB", "start ms", "frame ms")], costs)
    )


if __name__ == "__main__":
    main()
