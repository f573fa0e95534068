#!/usr/bin/env python3
"""Simulate training data into shards; after an interruption, run it again to continue.

::

    .venv-train/bin/python -m tools.training.make_data --out DATA --sensors 2400 [--frames 12]


Shard k holds the sensors of the 24 seeds from FIRST_SEED + 24 k on, so the same command makes the
same data. Shards from 5000 on (`--first-shard 5000`) hold uneven sensors, those from 10000 on more
uneven ones, and those from 25000 on the sensors of `outside` (`samples.UNEVEN_FROM`, `WIDE_FROM`,
`OUTSIDE_FROM`).
"""

from __future__ import annotations

import argparse
import io
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacshade_edge.cli.shared.options import add_cluster
from tacshade_edge.lab.parallel import workers
from tools.studies import command
from tools.training.outside import VIEWS
from tools.training.samples import sensor_samples, shards

FIRST_SEED = 100_000
SENSORS_PER_SHARD = 24


def make_shard(job: tuple[int, int]) -> tuple[bytes, str]:
    """Simulate one shard; return the file's content and a line about the cost."""
    first_seed, frames = job
    start = time.perf_counter()
    seeds = range(first_seed, first_seed + SENSORS_PER_SHARD, VIEWS)
    made = [samples for seed in seeds for samples in sensor_samples(seed, frames)]
    file = io.BytesIO()
    np.savez_compressed(
        file,
        reference=np.stack([s.reference for s in made]),
        known=np.stack([s.known for s in made]).astype(np.float16),
        frame=np.stack([s.frame for s in made]),
        height=np.stack([s.height for s in made]),
        contact=np.packbits(np.stack([s.contact for s in made]), axis=-1),
        shear=np.stack([s.shear for s in made]),
    )
    seconds = time.perf_counter() - start
    return (
        file.getvalue(),
        f"{len(made)} sensors, {1e3 * seconds / (len(made) * frames):.0f} ms a frame",
    )


def main(words: Sequence[str] | None = None) -> None:
    """Simulate the missing shards."""
    parser = argparse.ArgumentParser(description="Simulated training data.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sensors", type=int, default=2400, help="of all kinds together")
    parser.add_argument("--frames", type=int, default=12, help="of each sensor")
    add_cluster(parser)
    args = parser.parse_args(words)
    paths = {
        k: args.out / f"shard_{k:05d}.npz" for k in shards(-(-args.sensors // SENSORS_PER_SHARD))
    }
    jobs = {
        path: (FIRST_SEED + k * SENSORS_PER_SHARD, args.frames)
        for k, path in paths.items()
        if not path.exists()
    }
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        for path, (content, line) in zip(jobs, pool.map(make_shard, jobs.values()), strict=True):
            part = path.with_suffix(".part")
            part.write_bytes(content)
            os.replace(part, path)
            print(f"{path.name}: {line}", flush=True)


if __name__ == "__main__":
    main()
