#!/usr/bin/env python3
"""Simulate training data into shards; run again to go on where it stopped.

::

    .venv-train/bin/python -m tools.training.make_data --out DATA --sensors 2400 [--frames 12] [--workers 2]

Shard k holds the sensors of seeds FIRST_SEED + 24 k and following: the same command, the same data. Shards from 5000 on
(`--first-shard 5000`) hold sensors that are uneven, from 10000 on more so, from 25000 on those of `outside`
(`samples.UNEVEN_FROM`, `WIDE_FROM`, `OUTSIDE_FROM`).
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from pathlib import Path

import numpy as np

from tools.training.outside import VIEWS
from tools.training.samples import OUTSIDE_FROM, sensor_samples

FIRST_SEED = 100_000
SENSORS_PER_SHARD = 24


def make_shard(job: tuple[Path, int, int]) -> str:
    """Simulate one shard, whole or not at all."""
    path, first_seed, frames = job
    if path.exists():
        return ""
    start = time.perf_counter()
    seeds = range(first_seed, first_seed + SENSORS_PER_SHARD, VIEWS if first_seed >= OUTSIDE_FROM else 1)
    made = [samples for seed in seeds for samples in sensor_samples(seed, frames)]
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez_compressed(
            file,
            reference=np.stack([s.reference for s in made]),
            known=np.stack([s.known for s in made]).astype(np.float16),
            frame=np.stack([s.frame for s in made]),
            height=np.stack([s.height for s in made]),
            contact=np.packbits(np.stack([s.contact for s in made]), axis=-1),
            shear=np.stack([s.shear for s in made]),
        )
    os.replace(part, path)
    seconds = time.perf_counter() - start
    return f"{path.name}: {len(made)} sensors, {1e3 * seconds / (len(made) * frames):.0f} ms a frame"


def main() -> None:
    """Simulate what is not there yet."""
    parser = argparse.ArgumentParser(description="Simulated training data.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sensors", type=int, default=2400)
    parser.add_argument("--frames", type=int, default=12, help="of each sensor")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--first-shard", type=int, default=0)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    numbers = range(args.first_shard, args.first_shard - (-args.sensors // SENSORS_PER_SHARD))
    jobs = [(args.out / f"shard_{k:05d}.npz", FIRST_SEED + k * SENSORS_PER_SHARD, args.frames) for k in numbers]
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        for line in pool.imap(make_shard, jobs):
            if line:
                print(line, flush=True)


if __name__ == "__main__":
    main()
