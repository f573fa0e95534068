#!/usr/bin/env python3
"""What the factor that presses teach is worth on other shapes, pressed and dragged.

::

    .venv/bin/python -m tools.studies.factor [--sensors 60,other:41] [--workers N]

Sensors are calibrated with 40 balls, or with 40 balls, flat ends, squares and bars; Table I's objects are then pressed,
and dragged by 2 mm. The table has the mean error in contact with the factor over that without it, on average and on the
worst sensor, and what the best factor of each sensor would give.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from tacshade_edge.core.calibration.calibrate import CalibrationResult
from tacshade_edge.core.calibration.refit import refit_profile
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.geometry.disc_map import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import LADDER, PROFILES
from tacshade_edge.inference.network import load_networks
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F64
from tools.studies.fit import calibrated, judged_scenes, pressed
from tools.studies.sigma import true_height_mm
from tools.testbed.simulator.families import sensor_name

SENSORS = ",".join(f"{60 + k},other:{41 + k}" for k in range(8))
LOG_FACTORS = np.linspace(-0.4, 0.4, 41)
LEAST_CELLS = 12


def measured(text: str) -> dict[tuple[str, str], tuple[float, F64]]:
    """The log factor that presses teach each profile, and the ME of other shapes at `LOG_FACTORS`, mm."""
    name = sensor_name(text)
    sensor, networks, seed = name.make(), load_networks(), name.seed or 0
    results: dict[str, CalibrationResult] = {
        kind: calibrated(sensor, pressed(sensor, seed, kind == "balls")) for kind in ("balls", "mixed")
    }
    bare = replace(results["balls"].calibration, factors={})
    made = {}
    for profile in LADDER:
        preprocessor = Preprocessor(bare, PROFILES[profile])
        made[profile] = preprocessor, LearnedSolver(preprocessor, networks[profile])
    curves: dict[str, list[list[float]]] = {profile: [] for profile in LADDER}
    for kind, scene in judged_scenes(sensor, seed):
        if kind == "beyond":
            continue
        frame = sensor.frame((scene.press,), scene.noise_seed)
        for profile, (preprocessor, solver) in made.items():
            inverse = solver.inverse(preprocessor.preprocess(preprocessor.grey(frame.image)))
            where = (inverse.contact_logit > 0) & rays_in_image(solver.grid, bare).inside
            if np.count_nonzero(where) < LEAST_CELLS:
                continue
            found, true = np.nan_to_num(inverse.height_mm)[where], true_height_mm(frame, solver.grid, where)
            curves[profile].append([float(np.abs(np.exp(log) * found - true).mean()) for log in LOG_FACTORS])
    rows = {}
    for kind, result in results.items():
        for profile in LADDER:
            refit = refit_profile(bare, PROFILES[profile], networks[profile], result.presses)
            rows[kind, profile] = float(np.log(refit.factor)) if refit else 0.0, np.mean(curves[profile], axis=0)
    return rows


def table(sensors: Sequence[dict[tuple[str, str], tuple[float, F64]]]) -> list[list[str]]:
    """A row for each kind of presses and profile."""
    lines = []
    for kind, profile in sensors[0]:
        each = [of[kind, profile] for of in sensors]
        without, with_factor, best = (
            np.array([of_sensor(log, curve) for log, curve in each])
            for of_sensor in (
                lambda _, curve: np.interp(0, LOG_FACTORS, curve),
                lambda log, curve: np.interp(log, LOG_FACTORS, curve),
                lambda _, curve: curve.min(),
            )
        )
        ratios = with_factor / without
        figures: list[Any] = [without.mean(), with_factor.mean(), ratios.mean(), ratios.max(), (best / without).mean()]
        lines.append([kind, profile, *(f"{value:.3f}" for value in figures)])
    return lines


def main() -> None:
    """Measure every sensor and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default=SENSORS)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    with ProcessPoolExecutor(args.workers) as pool:
        sensors = list(pool.map(measured, args.sensors.split(",")))
    head = ["presses", "method", "ME without mm", "with mm", "with over without", "worst", "best possible"]
    print(markdown(head, table(sensors)))


if __name__ == "__main__":
    main()
