#!/usr/bin/env python3
"""What the paper's 25 iterations gain: `paper` compared with the same maps without them (α · g_hn).

::

    .venv/bin/python -m tools.studies.iterations

Three sensors, the paper's five objects near the middle at three depths. docs/results/iterations.md has the output.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from tacshade_edge.core.depth.hybrid_sfs import HybridSfs
from tacshade_edge.core.image.grey_maps import GreyMapper
from tacshade_edge.core.image.greyscale import shape_grey, to_grey
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, scenes
from tacshade_edge.studies.evaluate.score import KnownTruth, Label, Row, score
from tacshade_edge.studies.evaluate.sensors import SensorName, calibrated, reconstructor
from tacshade_edge.studies.evaluate.summary import figures
from tacshade_edge.studies.scaled_grey import scaled_grey
from tacshade_edge.types import Calibration, Frame

SENSORS = ("default", "5", "11")


def without_iterations(calibration: Calibration) -> Reconstructor:
    """`paper` without its iterations: α g_hn."""
    profile = replace(PROFILES["paper"], name="paper_0")
    return Reconstructor(calibration, profile, make_solver=partial(HybridSfs, depth=scaled_grey))


def main() -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    rows: list[Row] = []
    taken: dict[str, list[float]] = {"paper": [], "paper_0": []}
    correlations = []
    for name in map(SensorName.parse, SENSORS):
        sensor, calibration = name.make(), calibrated(name, 8, 40).calibration
        preprocessor = Preprocessor(calibration, PROFILES["paper"])
        grey_mapper = GreyMapper(preprocessor)
        methods = (reconstructor(calibration, "paper"), without_iterations(calibration))
        for object_name in PAPER_OBJECTS:
            for scene in scenes(sensor.model, name.seed, object_name)[: len(DEPTHS_MM)]:
                frame = sensor.frame((scene.press,), scene.noise_seed)
                truth = KnownTruth.of(frame.truth())
                for made in methods:
                    start = time.process_time()
                    result = made.step(Frame(0, 0, 0, frame.image))
                    taken[result.profile].append(1e3 * (time.process_time() - start))
                    rows.append(score(Label(str(name), object_name), truth, result))
                    if result.profile == "paper":
                        maps = grey_mapper.maps(preprocessor.preprocess(to_grey(frame.image)))
                        g_hn = shape_grey(maps.g_d, maps.g0, maps.inside)[maps.inside]
                        height = result.height.height_mm[maps.inside]
                        correlations.append(float(np.corrcoef(height, g_hn)[0, 1]))
    print("| method | ME mm | SD % | contact IoU | depth error % (mean, worst) | ms of processor time (p50) |")
    print("|---|---|---|---|---|---|")
    for method, ms in taken.items():
        f = figures(r for r in rows if r.profile == method)
        cells = f"{f.me_mm:.2f} | {f.sd_pct:.0f} | {f.iou:.2f} | {f.depth_error_pct:.0f}, {f.depth_error_worst_pct:.0f}"
        print(f"| {method} | {cells} | {np.median(ms):.1f} |")
    print(f"\nCorrelation of the result with the grey image g_hn: {min(correlations):.4f} to {max(correlations):.4f}.")
    print(f"`paper` takes {np.median(taken['paper']) / np.median(taken['paper_0']):.1f} times as long.")
    print(f"Pixels that `paper` had to repair: {sum(r.repaired_px for r in rows if r.profile == 'paper')}.")


if __name__ == "__main__":
    main()
