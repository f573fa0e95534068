#!/usr/bin/env python3
"""What `paper` and `fast` find on the simulated sensor, and at what cost: docs/accuracy-and-speed.md has the table.

::

    .venv/bin/python tools/bench_baseline.py [--json FILE]

Three sensors (the default one and two drawn at random), each calibrated on 40 ball presses; the paper's five objects,
pressed 1.5, 3 and 4.5 mm deep beside the middle. Three methods on the same frames: `paper`; `paper_0`, which is the
same without its 25 iterations (α · g_hn on the same maps); `fast`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core.calibrate import BallPress, Sensor, calibrate
from tacshade_edge.core.greyscale import shape_grey, to_grey
from tacshade_edge.core.metrics import contact_iou, score_cloud
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.core.solvers.paper import hybrid_sfs
from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame, SimulatedSensor
from tacshade_edge.types import Calibration, Frame

SENSOR_SEEDS = (None, 5, 11)
DEPTHS_MM = (1.5, 3.0, 4.5)
PLACE_MM = (1.5, -1.0)
PRESSES = 40
TABLE_I = {
    "cube": (0.9120, 78.63),
    "small_crescent": (0.5008, 85.33),
    "ball": (0.1039, 96.02),
    "large_crescent": (0.7849, 77.84),
    "cylinder": (0.8934, 72.49),
}


@dataclass(frozen=True, slots=True)
class Row:
    """One method on one press."""

    method: str
    sensor: str
    shape: str
    pressed_mm: float
    found_mm: float
    me_mm: float
    sd: float
    iou: float
    objects: int
    repaired_px: int
    ms: float


def calibrated(simulated: SimulatedSensor) -> Calibration:
    """Calibrate as a user does."""
    model = simulated.model
    sensor = Sensor(model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright")
    references = [simulated.frame((), 1000 + k).image for k in range(8)]
    presses = [
        BallPress(f"press {k}", simulated.frame([p], 2000 + k).image, r, p.depth_mm, p.x_mm, p.y_mm)
        for k, (p, r) in enumerate(ball_presses(model, PRESSES))
    ]
    return calibrate(sensor, references, presses).calibration


def measure(method: str, sensor: str, made: Reconstructor, shape: str, frame: SimulatedFrame) -> Row:
    """Reconstruct one frame and score it against its truth."""
    truth = frame.truth()
    start = time.perf_counter()
    result = made.step(Frame(0, 0, 0, frame.image))
    ms = 1e3 * (time.perf_counter() - start)
    height = result.height
    step, row0, col0 = int(height.step_px), int(height.row0), int(height.col0)
    rows, cols = height.contact.shape
    true_contact = truth.contact[row0::step, col0::step][:rows, :cols]
    score = score_cloud(result.cloud.points_mm, truth.points_mm, truth.depth_max_mm)
    return Row(
        method=method,
        sensor=sensor,
        shape=shape,
        pressed_mm=truth.depth_max_mm,
        found_mm=result.depth_max_mm,
        me_mm=score.me_mm,
        sd=score.sd,
        iou=contact_iou(height.contact, true_contact),
        objects=len(result.objects),
        repaired_px=result.repaired_px,
        ms=ms,
    )


def iterations_buy(made: Reconstructor, frame: SimulatedFrame) -> float:
    """Correlation of the paper's result with the grey image that it started from, inside the disc."""
    maps = made.grey_maps(to_grey(frame.image))
    g_hn = shape_grey(maps.g_d, maps.g0, maps.inside).astype(np.float64)
    z, _ = hybrid_sfs(g_hn)
    return float(np.corrcoef(z[maps.inside], g_hn[maps.inside])[0, 1])


def run(report: Callable[[str], None]) -> tuple[list[Row], list[float]]:
    """All sensors, objects, depths and methods."""
    rows, correlations = [], []
    paper = PROFILES["paper"]
    no_iterations = Profile("paper_0", "fast", paper.stride_px, paper.window_pitches, paper.tv_weight)
    none = np.zeros(0, dtype=np.float32)
    for seed in SENSOR_SEEDS:
        simulated = SimulatedSensor(SensorModel() if seed is None else random_model(seed))
        calibration = calibrated(simulated)
        without_table = replace(calibration, table_grey=none, table_depth_mm=none, table_gain=none)
        methods = {
            "paper": Reconstructor(calibration, paper),
            "paper_0": Reconstructor(without_table, no_iterations),
            "fast": Reconstructor(calibration, PROFILES["fast"]),
        }
        scale = simulated.model.skin_radius_mm / 20
        for shape in PAPER_OBJECTS:
            for depth in DEPTHS_MM:
                press = Press(OBJECTS[shape](), PLACE_MM[0], PLACE_MM[1], depth, scale=scale)
                frame = simulated.frame([press], 7)
                name = "default" if seed is None else f"seed {seed}"
                rows += [measure(method, name, made, shape, frame) for method, made in methods.items()]
                correlations.append(iterations_buy(methods["paper"], frame))
            report(f"{name} {shape}")
    return rows, correlations


def table(rows: list[Row], correlations: list[float]) -> str:
    """The document's table, in Markdown."""
    lines = [
        "| object | method | ME mm | SD % | contact IoU | depth error % (mean, worst) | ms (p50) |",
        "|---|---|---|---|---|---|---|",
    ]
    for shape in (*PAPER_OBJECTS, "mean"):
        if shape in TABLE_I:
            me, sd = TABLE_I[shape]
            lines.append(f"| {shape} | the paper's Table I (real sensor) | {me:.3f} | {sd:.1f} | | | |")
        for method in ("paper", "paper_0", "fast"):
            some = [r for r in rows if r.method == method and shape in (r.shape, "mean")]
            off = np.array([abs(r.found_mm / r.pressed_mm - 1) for r in some]) * 100
            me = np.mean([r.me_mm for r in some])
            sd, iou = 100 * np.mean([r.sd for r in some]), np.mean([r.iou for r in some])
            ms = np.median([r.ms for r in some])
            figures = f"{me:.2f} | {sd:.0f} | {iou:.2f} | {off.mean():.0f}, {off.max():.0f} | {ms:.1f}"
            lines.append(f"| {shape} | {method} | {figures} |")
    p50 = {m: np.median([r.ms for r in rows if r.method == m]) for m in ("paper", "paper_0", "fast")}
    low, high = min(correlations), max(correlations)
    times_0, times_fast = p50["paper"] / p50["paper_0"], p50["paper"] / p50["fast"]
    lines += [
        "",
        f"Correlation of the paper's |Z| with the grey image it started from: {low:.4f} to {high:.4f}.",
        f"`paper` takes {times_0:.1f} times `paper_0` and {times_fast:.0f} times `fast`.",
        f"Pixels that `paper` had to repair: {sum(r.repaired_px for r in rows if r.method == 'paper')}.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print the table."""
    parser = argparse.ArgumentParser(description="Baseline accuracy and cost on the simulated sensor.")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write every row here")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rows, correlations = run(lambda text: print(text, file=sys.stderr) if sys.stderr.isatty() else None)
    print(table(rows, correlations))
    if args.json:
        fields = Row.__slots__
        args.json.write_text(json.dumps([{f: getattr(r, f) for f in fields} for r in rows], indent=1, default=float))


if __name__ == "__main__":
    main()
