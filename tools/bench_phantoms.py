#!/usr/bin/env python3
"""Frames without contact under every nuisance we know how to make: which are taken for a contact, and how deep.

::

    .venv/bin/python tools/bench_phantoms.py

Three sensors, each calibrated on 40 ball presses. Prints a line per phantom and a table: frames, refused as invalid,
degraded, phantoms.
"""

from __future__ import annotations

from collections import defaultdict

import cv2
import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.devices.network import make_reconstructor
from tacshade_edge.simulator import nuisance
from tacshade_edge.studies.evaluate.sensors import SensorName, calibrated
from tacshade_edge.types import U8, Disc, Frame

SENSORS = ("default", "5", "11")
PLACES = ((0.0, 0.0), (0.4, 0.2), (-0.5, 0.5), (0.1, -0.8))  # row, col in disc radii


def cases(image: U8, disc: Disc) -> dict[str, list[tuple[str, U8]]]:
    """Kind of nuisance to named images."""
    made: dict[str, list[tuple[str, U8]]] = defaultdict(list)
    made["none"] = [("", image)]
    made["light within 20 %"] = [(f"x{k}", nuisance.gain(image, k)) for k in (0.8, 0.9, 1.1, 1.2)]
    made["light beyond"] = [(f"x{k}", nuisance.gain(image, k)) for k in (0.3, 0.5, 0.7, 1.3, 1.5, 2, 3, 4)]
    made["shift by a pixel"] = [
        (f"{d}", nuisance.shift(image, *d)) for d in ((1, 0), (0, 1), (-1, 0), (0, -1), (-1, -1), (1, -1))
    ]
    made["shift by 2 to 5 px"] = [(f"{d}", nuisance.shift(image, *d)) for d in ((2, 0), (0, 3), (5, 5))]
    made["noise to 10 grey levels"] = [(f"{s}", nuisance.noise(image, s, 1)) for s in (3, 6, 10)]
    made["noise beyond"] = [(f"{s}", nuisance.noise(image, s, 1)) for s in (15, 20, 30, 50)]
    made["defocus"] = [(f"{s} px", nuisance.defocus(image, s)) for s in (1, 2, 3, 5)]
    made["black, white, saturated"] = [("", image * 0), ("", image * 0 + 255), ("", nuisance.gain(image, 6))]
    for row in (100, 240, 380):
        for shift in (3, 10, 40, 200):
            made["torn, shifted"].append((f"row {row}, {shift} px", nuisance.torn(image, image, row, shift)))
        made["torn, black or grey"].append((f"row {row}", nuisance.torn(image, image * 0, row)))
        made["torn, black or grey"].append((f"row {row}", nuisance.torn(image, image * 0 + 128, row)))
    for sigma in (2, 3, 5, 8, 12, 20, 30):
        kind = "glare of 8 px and more, 150 levels and more"
        for level in (80, 150, 220, 255):
            for r, c in PLACES:
                spot = nuisance.glare(
                    image, disc.row_c + r * disc.radius_px, disc.col_c + c * disc.radius_px, sigma, level
                )
                name = kind if sigma >= 8 and level >= 150 else "glare smaller or weaker"
                made[name].append((f"{sigma} px, {level} levels at {r}, {c}", spot))
    return made


def main() -> None:
    """Measure, print."""
    cv2.setNumThreads(1)
    counts: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(4, dtype=int))
    deepest: dict[str, float] = defaultdict(float)
    for sensor in map(SensorName.parse, SENSORS):
        simulated, calibration = sensor.make(), calibrated(sensor, 8, 40).calibration
        made = make_reconstructor(calibration, PROFILES["fast"])
        for kind, images in cases(simulated.frame((), 5).image, calibration.geometry.disc).items():
            for name, image in images:
                result = made.step(Frame(0, 0, 0, image))
                counts[kind] += (1, not result.valid, bool(result.degraded), result.contact)
                if result.contact:
                    deepest[kind] = max(deepest[kind], result.depth_max_mm)
                    print(f"phantom: sensor {sensor}, {kind}, {name}: {result.depth_max_mm:.2f} mm {result.degraded}")
    print(
        "\n| frames without contact | frames | invalid | degraded | phantoms | deepest mm |\n|---|---|---|---|---|---|"
    )
    for kind, row in counts.items():
        print(f"| {kind} | {' | '.join(map(str, row))} | {deepest[kind]:.2f} |")


if __name__ == "__main__":
    main()
