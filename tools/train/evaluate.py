#!/usr/bin/env python3
"""Score an ONNX network on sensors it was not trained on, with the product's measures.

::

    .venv-train/bin/python tools/train/evaluate.py --onnx FILE [--cache DIR] [--sensors 5,11,21] [--other 31,32]

Table I's five objects, 1.5, 3 and 4.5 mm deep, at three places; first with one reference and no press, then with 8
references and a refit on 40 ball presses. Seeds below 9000 are for working; those from 9000 on are kept for the final
figures and are not to be used before.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core import discmap, pattern
from tacshade_edge.core.disc import Grid, disc_mask, disc_rays
from tacshade_edge.core.greyscale import binarise, to_grey
from tacshade_edge.core.metrics import contact_iou, score_cloud
from tacshade_edge.core.refit import Ball, apply_refit, fit_refit, press_rows, stated_ball
from tacshade_edge.core.skin import skin_points
from tacshade_edge.core.solvers.learned import Inverse, LearnedInverse
from tacshade_edge.devices.network import read_network
from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.simulator.other_family import OtherSensor, other_model
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.types import F32, U8, Geometry

DEPTHS_MM = (1.5, 3.0, 4.5)
PLACES_MM = ((1.5, -1.0, 0.0), (-5.0, 3.0, 25.0), (3.0, 6.5, 70.0))
"""x, y and rotation in degrees."""
STRIDE_PX = 4
PRESSES = 40


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A press with its truth on the product's grid."""

    shape: str
    image: U8
    contact: np.ndarray
    height: F32
    points: F32
    depth_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """Everything that was photographed of one sensor."""

    model: SensorModel
    references: list[U8]
    presses: list[tuple[U8, Press, float]]
    scenes: list[Scene]


def take(model: SensorModel, other: bool, shapes: Sequence[str]) -> Taken:
    """Photograph a sensor."""
    sensor = OtherSensor(model) if other else SimulatedSensor(model)
    references = [to_grey(sensor.frame((), 1000 + k).image) for k in range(8)]
    presses = [
        (to_grey(sensor.frame([p], 2000 + k).image), p, r) for k, (p, r) in enumerate(ball_presses(model, PRESSES))
    ]
    grid = Grid.of_image(model.image_height_px, model.image_width_px, STRIDE_PX)
    r0, c0, step = int(grid.row0), int(grid.col0), STRIDE_PX
    scale = model.skin_radius_mm / 20
    scenes = []
    for name in shapes:
        for k, (x, y, turn) in enumerate(PLACES_MM):
            for depth in DEPTHS_MM:
                press = Press(OBJECTS[name](), x * scale, y * scale, depth, turn, scale)
                frame = sensor.frame([press], 7 + k)
                truth = frame.truth()
                if not truth.contact.any():
                    continue
                scenes.append(
                    Scene(
                        name,
                        to_grey(frame.image),
                        truth.contact[r0::step, c0::step][: grid.rows, : grid.cols],
                        truth.height_mm[r0::step, c0::step][: grid.rows, : grid.cols],
                        truth.points_mm,
                        truth.depth_max_mm,
                    )
                )
    return Taken(model, references, presses, scenes)


def cached(folder: Path | None, model: SensorModel, other: bool, shapes: Sequence[str]) -> Taken:
    """`take`, or what it took before."""
    if folder is None:
        return take(model, other, shapes)
    key = hashlib.sha256(repr((model, other, tuple(shapes), PLACES_MM, DEPTHS_MM)).encode()).hexdigest()[:16]
    path = folder / f"taken_{key}.npz"
    presses = ball_presses(model, PRESSES)
    if not path.exists():
        made = take(model, other, shapes)
        folder.mkdir(parents=True, exist_ok=True)
        fields = ("shape", "image", "contact", "height", "depth_mm")
        arrays = {f: np.stack([np.asarray(getattr(s, f)) for s in made.scenes]) for f in fields}
        np.savez_compressed(
            path,
            references=np.stack(made.references),
            presses=np.stack([p[0] for p in made.presses]),
            count=np.array([len(s.points) for s in made.scenes]),
            points=np.concatenate([s.points for s in made.scenes]),
            **arrays,
        )
        return made
    with np.load(path) as stored:
        points = np.split(stored["points"], np.cumsum(stored["count"])[:-1])
        columns = [stored[f] for f in ("shape", "image", "contact", "height", "depth_mm")]
        scenes = [Scene(str(n), i, c, h, p, float(d)) for n, i, c, h, d, p in zip(*columns, points, strict=True)]
        pressed = [(image, p, r) for image, (p, r) in zip(stored["presses"], presses, strict=True)]
        return Taken(model, list(stored["references"]), pressed, scenes)


class Solver:
    """The learned inverse of one sensor from its references."""

    def __init__(self, onnx: Path, model: SensorModel, references: list[U8]) -> None:
        mean = pattern.mean_image(references)
        disc = pattern.find_disc(mean)
        self._pitch_px = pattern.marker_pitch_px(mean, disc)
        self.geometry = Geometry(model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, disc)
        self._mask = disc_mask(*mean.shape, disc).astype(np.uint8)
        white = np.mean([self._white(r) for r in references], axis=0)
        reference = np.rint(255 * white).astype(np.uint8)
        self._inverse = LearnedInverse(read_network(onnx), self.geometry, self._pitch_px, reference)
        self.known = self._inverse.known

    def _white(self, image: U8) -> U8:
        return binarise(image, self._mask, "adaptive", self._pitch_px)

    def maps(self, image: U8) -> Inverse:
        """H in mm and contact logit on the map's cells."""
        return self._inverse(self._white(image))


@dataclass(frozen=True, slots=True)
class Row:
    """One press scored."""

    way: str
    sensor: str
    shape: str
    pressed_mm: float
    found_mm: float
    me_mm: float
    sd: float
    iou: float
    rms_mm: float
    bias_mm: float
    me_true_outline: float


def score(way: str, name: str, solver: Solver, refit: F32, scene: Scene) -> Row:
    """Reconstruct and compare."""
    inverse = solver.maps(scene.image)
    height = apply_refit(refit, inverse.height_mm, solver.known)
    disc = solver.geometry.disc
    grid = Grid.of_image(*scene.image.shape, STRIDE_PX)
    rays = disc_rays(grid, solver.geometry)
    h = np.maximum(discmap.at_grid(height, disc, grid), 0)
    touched = (discmap.at_grid(inverse.contact_logit, disc, grid) > 0) & rays.inside
    points, _ = skin_points(h, rays, solver.geometry)
    result = score_cloud(points[touched], scene.points, scene.depth_mm)
    ideal = score_cloud(points[scene.contact & rays.inside], scene.points, scene.depth_mm)
    off = (h - scene.height)[scene.contact]
    off = off[np.isfinite(off)]
    return Row(
        way, name, scene.shape, scene.depth_mm, float(h[touched].max(initial=0.0)), result.me_mm, result.sd,
        contact_iou(touched, scene.contact), float(np.sqrt(np.mean(off**2))), float(np.mean(off)), ideal.me_mm,
    )  # fmt: skip


def evaluate(onnx: Path, taken: Taken, name: str) -> list[Row]:
    """Without a press and with 40."""
    one = Solver(onnx, taken.model, taken.references[:1])
    many = Solver(onnx, taken.model, taken.references)
    presses = [
        rows
        for image, press, radius in taken.presses
        if (rows := press_rows(many.maps(image), many.known, many.geometry, _ball(many.geometry, press, radius)))
    ]
    result = [score("no press", name, one, np.zeros(0, np.float32), s) for s in taken.scenes]
    refit = fit_refit(presses)
    return result + [score("40 presses", name, many, refit, s) for s in taken.scenes]


def _ball(geometry: Geometry, press: Press, radius_mm: float) -> Ball:
    return stated_ball(geometry, press.x_mm, press.y_mm, press.depth_mm, radius_mm)


def summary(rows: Sequence[Row]) -> dict[str, float]:
    """What the issue asks for."""
    shapes = sorted({r.shape for r in rows})

    def by_shape(values: dict[str, list[float]]) -> list[float]:
        return [float(np.mean(values[s])) for s in shapes]

    me = by_shape({s: [10.0 if math.isnan(r.me_mm) else r.me_mm for r in rows if r.shape == s] for s in shapes})
    sd = by_shape({s: [100 * r.sd for r in rows if r.shape == s] for s in shapes})
    depth = [100 * abs(r.found_mm / r.pressed_mm - 1) for r in rows]
    return {
        "ME": float(np.mean(me)),
        "ME worst": max(me),
        "SD": float(np.mean(sd)),
        "SD worst": min(sd),
        "IoU": float(np.mean([r.iou for r in rows])),
        "depth %": float(np.mean(depth)),
        "RMS": float(np.mean([r.rms_mm for r in rows])),
        "bias": float(np.mean([r.bias_mm for r in rows])),
        "ME true outline": float(np.nanmean([r.me_true_outline for r in rows])),
    }


def table(rows: Sequence[Row], group: str) -> str:
    """Markdown, one line for each way and value of `group`."""
    lines = []
    for way in ("no press", "40 presses"):
        some = [r for r in rows if r.way == way]
        for value in sorted({getattr(r, group) for r in some}):
            figures = summary([r for r in some if getattr(r, group) == value])
            if not lines:
                names = list(figures)
                lines += ["| way | " + " | ".join((group, *names)) + " |", "|---" * (len(names) + 2) + "|"]
            lines.append(f"| {way} | {value} | " + " | ".join(f"{v:.3g}" for v in figures.values()) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Score the learned inverse.")
    parser.add_argument("--onnx", type=Path, required=True)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--sensors", default="0,5,11,21", help="seeds; 0 is the default sensor")
    parser.add_argument("--other", default="31,32,33")
    parser.add_argument("--all-objects", action="store_true", help="all thirteen, not only Table I's five")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    shapes = tuple(OBJECTS) if args.all_objects else PAPER_OBJECTS
    rows: list[Row] = []
    for text, other in ((args.sensors, False), (args.other, True)):
        for seed in (int(s) for s in text.split(",") if s):
            model = other_model(seed) if other else random_model(seed) if seed else SensorModel()
            rows += evaluate(
                args.onnx, cached(args.cache, model, other, shapes), f"{'other' if other else 'own'} {seed}"
            )
    for own in (True, False):
        some = [r for r in rows if r.sensor.startswith("own") == own]
        if some:
            both = [replace(r, sensor="all") for r in some]
            print(f"\n{'Trained' if own else 'Other'} family\n\n{table(both, 'sensor')}\n\n{table(some, 'sensor')}")
            print(f"\n{table(some, 'shape')}")
    if args.json:
        args.json.write_text(json.dumps([{f: getattr(r, f) for f in Row.__slots__} for r in rows], indent=1))


if __name__ == "__main__":
    main()
