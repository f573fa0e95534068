#!/usr/bin/env python3
"""Learn the metric of recognition from touches of random solids on random sensors, and ship it.

::

    .venv/bin/python -m tools.training.learn_objects --data out/objects

It simulates the sensors whose files DATA lacks, so that it can be interrupted. No sensor and no
solid of `tools.studies.recognise` is among them.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.files.atomic_files import write_whole
from tacshade_edge.lab.parallel import workers
from tacshade_edge.lab.studies.evaluate.work import SensorName, calibrated
from tacshade_edge.sensor.geometry.disc import DiscRays, Grid, cells_in_image, disc_rays
from tacshade_edge.sensor.inference.network import WEIGHTS
from tacshade_edge.sensor.inference.object_names import METRIC
from tacshade_edge.sensor.recognition.answer import scores
from tacshade_edge.sensor.recognition.metric import Metric, coordinates, learn_metric
from tacshade_edge.types import F32, F64, I64, Disc, Geometry
from tools.studies import command
from tools.testbed.simulator.object_touches import SeenTouches, draw_touch, see_touches
from tools.training.random_solids import random_solid

FAMILIES = (
    *("tacshade", "tacshade", "other", "tacshade", "square"),
    *("tacshade", "other", "two-scales", "tacshade", "capped"),
)
"""Of the sensors, in turn."""
FIRST_SEED = 500_000
NUMBERS = (*range(11), 12, 13, *range(30, 37))
"""Of the sensors, counted from `FIRST_SEED`; the picture of number 11 seems pressed, so it is not
calibrated.
"""
SOLIDS, TOUCHES = 600, 180
"""Number of solids, and of touches of each sensor, with solids drawn at random."""
PRESSES = (0, 40)  # of the sensors' calibrations, in turn
REFERENCES = 8
PROFILES = ("fast", "balanced", "accurate")
TAUGHT_MAX, LEVELS = 5, 99
TRUSTS = np.geomspace(0.05, 2.0, 40)


def simulate(job: tuple[int, Path]) -> Path:
    """Write one sensor's touches."""
    number, path = job
    name = SensorName(FAMILIES[number % len(FAMILIES)], FIRST_SEED + number)
    calibration = calibrated(name, REFERENCES, PRESSES[number % len(PRESSES)]).calibration
    rng = np.random.default_rng((number, 7))
    solids = [random_solid(int(each)) for each in rng.integers(0, SOLIDS, TOUCHES)]
    sensor = name.make()
    presses = [draw_touch(rng, each, sensor.model.skin_radius_mm, tilts=True) for each in solids]
    seen = see_touches(sensor, calibration, presses, PROFILES)
    stream = io.BytesIO()
    about = {
        "sensor": str(name),
        "solids": [each.name for each in solids],
        "size": (calibration.image_height_px, calibration.image_width_px),
        "geometry": asdict(calibration.geometry),
        "grids": {p: (each.row0, each.col0, each.step_px) for p, each in seen.items()},
    }
    arrays: dict[str, Any] = {"about": json.dumps(about)}
    for profile, each in seen.items():
        arrays[f"heights_{profile}"] = np.asarray(each.heights_mm, np.float16)
        arrays[f"contact_{profile}"] = np.packbits(each.contact, axis=-1)
    np.savez_compressed(stream, **arrays)
    write_whole(path, stream.getvalue())
    return path


def described(path: Path) -> tuple[list[str], list[F32]]:
    """The solid and the description of every touch in a file, of each profile in turn."""
    names, found = [], []
    with np.load(path) as file:
        about = json.loads(str(file["about"]))
        known = about["geometry"]
        geometry = Geometry(**{**known, "disc": Disc(**known["disc"])})
        for profile, place in about["grids"].items():
            heights = file[f"heights_{profile}"].astype(np.float32)
            cols = heights.shape[2]
            contact = np.unpackbits(file[f"contact_{profile}"], axis=-1)[..., :cols].astype(bool)
            grid = Grid(heights.shape[1], cols, *place)
            rays = disc_rays(grid, geometry)
            rays = DiscRays(rays.inside & cells_in_image(grid, *about["size"]), rays.u, rays.v)
            row0, col0, step_px = place
            seen = SeenTouches(heights, contact, row0, col0, step_px, rays, geometry)
            for name, description in zip(about["solids"], seen.descriptions(), strict=True):
                if description is not None:
                    names.append(name)
                    found.append(description)
    return names, found


def own_scores(metric: Metric, descriptions: F32, objects: Sequence[str]) -> tuple[F32, float]:
    """Scores of touches with their own object after 1 to `TAUGHT_MAX` taught it, at `LEVELS`
    levels, and the trust that makes probabilities right, on touches and objects that the metric has
    not seen.
    """
    places = coordinates(metric, descriptions).astype(np.float64)
    rng = np.random.default_rng(1)
    rows = {name: np.flatnonzero(np.array(objects) == name) for name in set(objects)}
    rows = {name: rng.permutation(each) for name, each in sorted(rows.items())}
    levels = np.arange(1, LEVELS + 1) / (LEVELS + 1)
    found: list[F64] = []
    judged: tuple[F64, I64] = np.zeros((0, 0)), np.zeros(0, np.int64)
    for count in range(1, TAUGHT_MAX + 1):
        usable = [each for each in rows.values() if len(each) > count + 1]
        taught = np.stack([places[each[:count]].mean(axis=0) for each in usable])
        seen = np.concatenate([places[each[count:]] for each in usable])
        own = np.repeat(np.arange(len(usable)), [len(each) - count for each in usable])
        table = scores(metric.between, taught, np.full(len(usable), float(count)), seen)
        found.append(np.quantile(table[np.arange(len(own)), own], levels))
        if count == 3:
            judged = table, own
    return np.asarray(found, np.float32), _trust(*judged)


def _trust(table: F64, own: I64) -> float:
    """The factor on scores under which the own object among twenty, or none of
    them, is likeliest.
    """
    rng = np.random.default_rng(2)
    losses = np.zeros(len(TRUSTS))
    for row, truth in zip(table, own, strict=True):
        some = rng.choice(table.shape[1], 20, replace=False)
        some[0] = truth if rng.random() < 0.5 else some[0]
        chosen = np.append(row[some], 0.0)
        right = int(np.flatnonzero(some == truth)[0]) if truth in some else len(some)
        scaled = TRUSTS[:, None] * chosen
        top = scaled.max(axis=1)
        losses += top + np.log(np.exp(scaled - top[:, None]).sum(axis=1)) - scaled[:, right]
    return float(TRUSTS[np.argmin(losses)])


def learn(descriptions: F32, names: Sequence[str]) -> Metric:
    """Learn on all solids; scores and trust come from halves that judge each other."""
    numbers = np.array([int(name.rpartition("_")[2]) for name in names])
    halves = []
    for half in (0, 1):
        mine = numbers % 2 == half
        metric = learn_metric(descriptions[mine], numbers[mine])
        rest = np.flatnonzero(~mine)
        halves.append(own_scores(metric, descriptions[rest], [names[int(k)] for k in rest]))
    levels = np.mean([each[0] for each in halves], axis=0)
    trust = float(np.exp(np.mean(np.log([each[1] for each in halves]))))
    whole = learn_metric(descriptions, numbers)
    return replace(whole, scores=np.asarray(levels, np.float32), trust=trust)


def main(words: Sequence[str] | None = None) -> None:
    """Simulate what is missing, learn, and write the metric."""
    parser = argparse.ArgumentParser(description="The metric of recognition.")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR")
    args = parser.parse_args(words)
    paths = {k: args.data / f"sensor_{k:03d}.npz" for k in NUMBERS}
    jobs = [(k, path) for k, path in paths.items() if not path.exists()]
    with command.folder_for(parser, args.data), workers() as pool:
        for path in pool.map(simulate, jobs):
            print(path, flush=True)
    parts = [described(path) for path in paths.values()]
    names = [name for part in parts for name in part[0]]
    metric = learn(np.stack([each for part in parts for each in part[1]]), names)
    stream = io.BytesIO()
    arrays: dict[str, Any] = {each.name: getattr(metric, each.name) for each in fields(metric)}
    arrays["axes"] = metric.axes.astype(np.float16)  # no description is as precise
    np.savez_compressed(stream, **arrays)
    write_whole(WEIGHTS.parent / METRIC, stream.getvalue())
    print(f"{len(names)} descriptions of {len(set(names))} solids, {metric.axes.shape} axes")


if __name__ == "__main__":
    main()
