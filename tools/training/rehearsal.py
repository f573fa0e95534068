#!/usr/bin/env python3
"""Simulate the frames that ``calibrate --fit`` rehearses: ``tacshade_edge/fitting/rehearsal.npz``.

::

    .venv-train/bin/python -m tools.training.rehearsal

All kinds have the same number of sensors, whose seeds no shard of a training has. Whites have 16 levels: that is enough
to keep what a network knows, and halves the file.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import numpy as np

from tacshade_edge.fitting.rehearsal import FILE, LEVEL
from tools.training.kinds import KINDS, SHARDS_OF_A_KIND
from tools.training.make_data import FIRST_SEED, SENSORS_PER_SHARD
from tools.training.outside import VIEWS
from tools.training.samples import Samples, sensor_samples

FIRST_SHARD = 4000
"""Of each kind; trainings have far fewer."""
SKINS, FRAMES = 4, 4
"""Number of skins of each kind, each seen by `VIEWS` sensors, and of frames of each sensor."""


def made(seed: int) -> list[Samples]:
    """Simulate the sensors of one seed."""
    return sensor_samples(seed, FRAMES)


def main() -> None:
    """Write the file."""
    firsts = [FIRST_SEED + (SHARDS_OF_A_KIND * k + FIRST_SHARD) * SENSORS_PER_SHARD for k in range(len(KINDS))]
    with ProcessPoolExecutor() as pool:
        seeds = [first + VIEWS * k for first in firsts for k in range(SKINS)]
        samples = [each for some in pool.map(made, seeds) for each in some]
    geometry = [
        (
            each.seen.skin_radius_mm,
            each.seen.camera_distance_mm if each.seen.camera_distance_mm is not None else np.nan,
            each.seen.visible_half_angle_deg,
            each.pitch_px / each.seen.disc.radius_px,
        )
        for each in samples
    ]
    np.savez_compressed(
        FILE,
        geometry=np.array(geometry),
        reference=np.rint(np.stack([each.reference for each in samples]) / LEVEL).astype(np.uint8),
        frame=np.rint(np.stack([each.frame for each in samples]) / LEVEL).astype(np.uint8),
    )
    print(f"{len(samples)} sensors, {FILE.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
