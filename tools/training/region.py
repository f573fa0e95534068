#!/usr/bin/env python3
"""Measure how much of the disc a network must see: compare the contact's surroundings alone with the whole disc.

::

    .venv-train/bin/python -m tools.training.region --run RUN --profile accurate

The paper's five objects press the default sensor at three places and depths. The piece is the box around the contact
that the network finds on the whole disc, plus a margin on each side, in whole cells of the network's coarsest level.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from tacshade_edge.core.depth import NetworkMaps
from tacshade_edge.core.depth.learned import HEIGHT_SCALE
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import load_network
from tacshade_edge.studies.evaluate.sensors import SensorName, calibrated
from tacshade_edge.studies.evaluate.work import scenes
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F32, Bool, Frame
from tools.training.network import COARSE_CELLS, Net, trained

OBJECTS = ("ball", "cube", "cylinder", "edge", "ring")
MARGINS = (1 / 28, 1 / 14, 1 / 7, 2 / 7, 5 / 14)


def main() -> None:
    """Measure all margins and print the table."""
    parser = argparse.ArgumentParser(description="A network on a part of the disc.")
    parser.add_argument("--run", type=Path, required=True)
    learned = [name for name, profile in PROFILES.items() if profile.network]
    parser.add_argument("--profile", choices=learned, required=True)
    args = parser.parse_args()
    net, _ = trained(args.run)
    maps, inside, unit_mm = inputs(args.profile, net.fold)
    lines = []
    for margin in MARGINS:
        found = [piece(net, x, inside, max(1, round(margin * x.shape[-1]))) for x in maps]
        parts, errors, flips = (np.array(values) for values in zip(*found, strict=True))
        worst, middle = unit_mm * errors.max(), unit_mm * float(np.median(errors))
        lines.append([f"{100 * margin:.0f} %", f"{100 * parts.mean():.0f} %", f"{middle:.2f}", f"{worst:.2f}",
                      f"{flips.mean():.0f}"])  # fmt: skip
    heads = ["margin, of the map", "seen of it", "greatest error mm, median", "worst", "contact cells told otherwise"]
    print(markdown(heads, lines))


def inputs(profile: str, fold: int) -> tuple[list[F32], Bool, float]:
    """Collect each press's maps, (channels, N, N), the map's cells in the disc, and the network's unit in mm."""
    name = SensorName.parse("default")
    sensor, calibration = name.make(), calibrated(name, 8, 0).calibration
    known: list[F32] = []
    seen: list[F32] = []

    def sense(maps: F32) -> F32:
        known.append(maps)
        return maps

    def run(white: F32, _sensor: F32) -> NetworkMaps:
        seen.append(np.concatenate((white, known[0])))
        nothing = np.zeros((2 * fold * fold, *white.shape[1:]), np.float32)
        return NetworkMaps(nothing, np.zeros((COARSE_CELLS, COARSE_CELLS), np.float32))

    chosen = PROFILES[profile].network
    assert chosen is not None
    shipped = load_network(chosen)
    made = Reconstructor(calibration, PROFILES[profile], replace(shipped, fold=fold, sense=sense, run=run))
    for what in OBJECTS:
        for scene in scenes(sensor.model, name.seed, what):
            made.step(Frame(0, 0, 0, sensor.frame((scene.press,), scene.noise_seed).image))
    half = np.sin(np.radians(calibration.geometry.visible_half_angle_deg))
    return seen, made.rays.inside, float(calibration.geometry.skin_radius_mm * half / HEIGHT_SCALE)


def piece(net: Net, x: F32, inside: Bool, margin: int) -> tuple[float, float, int]:
    """Return the share of the map in the piece, the greatest difference of h, and the number of cells that flip.

    Both compare the piece with the whole disc. A cell flips if only one of the results calls it a contact.
    """
    height, logit = answer(net, x)
    touched = (logit > 0) & inside
    rows, cols = (at // net.fold for at in np.nonzero(touched))
    each = 2 ** (len(net.down) - 1)
    size = x.shape[-1]
    (top, bottom), (left, right) = (
        (max(0, (at.min() - margin) // each * each), min(size, -(-(at.max() + 1 + margin) // each) * each))
        for at in (rows, cols)
    )
    part_height, part_logit = answer(net, x[:, top:bottom, left:right])
    cut = (slice(top * net.fold, bottom * net.fold), slice(left * net.fold, right * net.fold))
    error = np.abs(part_height - height[cut])[touched[cut]].max()
    flips = np.count_nonzero((part_logit > 0)[inside[cut]] != (logit[cut] > 0)[inside[cut]])
    return float((bottom - top) * (right - left)) / size**2, float(error), int(flips)


def answer(net: Net, x: F32) -> tuple[F32, F32]:
    """Run the network and return height and contact logits."""
    with torch.no_grad():
        maps, _ = net(torch.from_numpy(x.copy())[None])
        height, logit = functional.pixel_shuffle(maps, net.fold)[0].numpy()
    return height, logit


if __name__ == "__main__":
    main()
