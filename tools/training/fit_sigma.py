#!/usr/bin/env python3
"""Fit the errors of the shipped networks: ``tacshade_edge/sensor/inference/weights/sigma.json``
(`sensor.depth.sigma`).

::

    .venv/bin/python -m tools.training.fit_sigma  # about ten minutes of one core

The weights are fitted to some objects, pressed and dragged. The relation between presses and error
scales is fitted to other objects on the same sensors, because errors are larger on objects that the
weights were not fitted to. The page docs/results/sigma.md uses neither these objects nor these
sensors. New networks need a new fit.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.calibration.refit import refit_profile
from tacshade_edge.cli.shared.options import add_cluster
from tacshade_edge.lab.parallel import workers
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.studies.evaluate.work import (
    PRESS_NOISE,
    PRESSES,
    REFERENCE_NOISE,
    REFERENCES,
    SensorName,
)
from tacshade_edge.sensor.contact.objects import contact_of
from tacshade_edge.sensor.depth.learned import LearnedSolver
from tacshade_edge.sensor.depth.sigma import INTERVAL_90, TERMS, SigmaModel, sigma_of_scale_1, terms
from tacshade_edge.sensor.geometry.disc_map import rays_in_image
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.inference.network import WEIGHTS, load_networks
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.sensor.reconstruct import no_mark
from tacshade_edge.types import F32, F64, Calibration, Geometry
from tools.studies import command
from tools.studies.sigma import NOISE, presses, true_height_mm
from tools.testbed.simulator.families import sensor_name

SENSORS = (
    "5",
    "11",
    "21",
    "50",
    "51",
    "52",
    "other:31",
    "other:32",
    "other:33",
    "other:34",
    "other:35",
    "other:36",
)
WEIGHT_OBJECTS = ("cube", "ball", "cylinder", "bar", "cross")
SCALE_OBJECTS = ("small_crescent", "plate", "prism", "two_balls")
EVERY = 4
"""One in this many presses of an object is measured, and one in this many cells of its contact."""
COVERED = 0.9
SMOOTH = (0.5, 0.2, 0.1)
"""Smoothing of the pinball loss, in log σ: each minimisation starts at the minimum before it."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells of contacts on one sensor by one network: `x` (N, len(TERMS)), `error_mm` (N,)."""

    x: F32
    error_mm: F64

    @classmethod
    def joined(cls, some: Iterable[Cells]) -> Cells:
        """Join the cells of several contacts."""
        each = list(some)
        return cls(np.concatenate([c.x for c in each]), np.concatenate([c.error_mm for c in each]))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A sensor, its calibration and presses, and the cells of each network.

    `weights` and `scales` hold cells of the objects for each of the two fits, with the factors that
    the calibration learned from the presses; `bare` holds those of `scales` without these factors.
    """

    name: SensorName
    calibration: Calibration
    pressed: list[KnownPress]
    weights: dict[str, Cells]
    scales: dict[str, Cells]
    bare: dict[str, Cells]

    @property
    def geometry(self) -> Geometry:
        """The sensor's geometry as calibrated."""
        return self.calibration.geometry


def measure(text: str) -> Measured:
    """Calibrate a sensor and press objects on it."""
    name = sensor_name(text)
    sensor = name.make()
    model, networks = sensor.model, load_networks()
    stated = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
    )
    references = [sensor.frame((), REFERENCE_NOISE + k).image for k in range(REFERENCES)]
    pressed = [
        KnownPress(
            f"press {k}",
            sensor.frame((p,), PRESS_NOISE + k).image,
            radius,
            p.depth_mm,
            p.x_mm,
            p.y_mm,
        )
        for k, (p, radius) in enumerate(ball_presses(model, PRESSES, name.seed or 0))
    ]
    calibration = calibrate(stated, references, pressed, networks=networks).calibration
    without = replace(calibration, factors={})
    found: dict[tuple[str, str], list[Cells]] = {}
    solvers = {}
    for network in LADDER:
        for kind, each in (("known", calibration), ("bare", without)):
            preprocessor = Preprocessor(each, PROFILES[network])
            solvers[network, kind] = preprocessor, LearnedSolver(preprocessor, networks[network])
    for objects, of in ((WEIGHT_OBJECTS, "weights"), (SCALE_OBJECTS, "scales")):
        for object_name in objects:
            for k, (_, press) in enumerate(presses(model, name.seed, object_name)):
                if k % EVERY:
                    continue
                frame = sensor.frame((press,), NOISE + k)
                for (network, kind), (preprocessor, solver) in solvers.items():
                    depth = solver.solve(
                        preprocessor.preprocess(preprocessor.grey(frame.image)), no_mark
                    )
                    inside = rays_in_image(solver.grid, calibration).inside
                    where = contact_of(depth, inside)
                    where[where] = np.arange(np.count_nonzero(where)) % EVERY == 0
                    if (
                        not where.any()
                        or depth.contact_logit is None
                        or depth.untrusted_logit is None
                    ):
                        continue
                    height = np.where(inside, depth.height_mm, np.float32(0))
                    x = terms(
                        height,
                        depth.contact_logit,
                        depth.untrusted_logit,
                        where,
                        calibration.geometry,
                    )
                    error_mm = np.abs(height[where] - true_height_mm(frame, solver.grid, where))
                    found.setdefault((network, of if kind == "known" else f"bare {of}"), []).append(
                        Cells(x, error_mm)
                    )
    taken = {
        of: {n: Cells.joined(found[n, of]) for n in LADDER}
        for of in ("weights", "scales", "bare scales")
    }
    print(f"{text}: {sum(len(c.error_mm) for c in taken['weights'].values())} cells", flush=True)
    return Measured(
        name, calibration, pressed, taken["weights"], taken["scales"], taken["bare scales"]
    )


def quantile_weights(x: F64, log_error: F64, of_each: F64) -> F64:
    """Find weights w so that x @ w is the quantile `COVERED` of log |error|, by a smoothed,
    weighted pinball loss.
    """
    found = np.zeros(x.shape[1])
    found[0] = np.quantile(log_error, COVERED)
    for smooth in SMOOTH:

        def loss(w: F64, smooth: float = smooth) -> tuple[float, F64]:
            rest = log_error - x @ w
            over = np.logaddexp(0, -rest / smooth)
            slope = COVERED - np.exp(-np.logaddexp(0, rest / smooth))
            return float(of_each @ (COVERED * rest + smooth * over)), -(x.T @ (of_each * slope))

        found = minimize(loss, found, jac=True, method="L-BFGS-B").x
    return found


def scale_of(model: SigmaModel, cells: Cells, geometry: Geometry) -> float:
    """Find the factor on σ with which a sensor's 90 % intervals hold 90 % of the errors."""
    off = cells.error_mm / sigma_of_scale_1(model, cells.x, geometry)
    return float(np.quantile(off, COVERED)) / INTERVAL_90


def fit(network: str, sensors: list[Measured]) -> SigmaModel:
    """Fit the error model of a network."""
    of = [sensor.weights[network] for sensor in sensors]
    size = np.array([sensor.geometry.skin_radius_mm / 20 for sensor in sensors])
    x = np.concatenate([cells.x for cells in of]).astype(np.float64)
    of_each = np.concatenate([np.full(len(c.x), 1 / len(c.x) / len(of)) for c in of])
    scales = np.zeros(len(of))
    for _ in range(6):  # alternate between all sensors' weights and each sensor's scale
        log_error = [
            np.log(c.error_mm / k + 1e-3) - s for c, k, s in zip(of, size, scales, strict=True)
        ]
        weights = quantile_weights(x, np.concatenate(log_error), of_each)
        model = SigmaModel((weights[0] - np.log(INTERVAL_90), *weights[1:]), 1.0, 0.0, 1.0)
        scales = np.log([scale_of(model, c, s.geometry) for c, s in zip(of, sensors, strict=True)])
    other = np.array([sensor.name.family != "tacshade" for sensor in sensors])
    usual = np.log([scale_of(model, s.scales[network], s.geometry) for s in sensors])[~other].mean()
    model = replace(
        model, weights=(float(model.weights[0] + usual), *map(float, model.weights[1:]))
    )
    needed = np.log([scale_of(model, s.scales[network], s.geometry) for s in sensors])
    bare = np.log([scale_of(model, s.bare[network], s.geometry) for s in sensors])
    shown = np.log([_press_q(network, model, sensor) for sensor in sensors])
    slope = float(np.cov(shown, needed, bias=True)[0, 1] / shown.var())
    offset = float(needed.mean() - slope * shown.mean())
    print(f"{network}: scales, from presses, without presses")
    for sensor, row in zip(
        sensors, zip(needed, offset + slope * shown, bare, strict=True), strict=True
    ):
        print(f"  {sensor.name!s:9}", *(f"{np.exp(value):6.2f}" for value in row))
    return replace(
        model,
        scale_without_presses=float(np.exp(bare[other].mean())),
        press_offset=offset,
        press_slope=slope,
    )


def _press_q(network: str, model: SigmaModel, sensor: Measured) -> float:
    known = replace(load_networks()[network], sigma=model)
    refit = refit_profile(sensor.calibration, PROFILES[network], known, sensor.pressed)
    assert refit is not None
    assert refit.error_scale is not None
    return refit.error_scale


def main() -> None:
    """Fit all networks and write the file."""
    parser = argparse.ArgumentParser(description="Fit how far off the shipped networks are.")
    add_cluster(parser)
    args = parser.parse_args()
    with command.folder_for(parser, None), workers(args.cluster) as pool:
        sensors = list(pool.map(measure, SENSORS))
    networks = {}
    for network in LADDER:
        model = fit(network, sensors)
        onnx = WEIGHTS / f"{network}.onnx"
        networks[network] = {
            "sha256": hashlib.sha256(onnx.read_bytes()).hexdigest(),
            "weights": {
                name: round(weight, 4) for name, weight in zip(TERMS, model.weights, strict=True)
            },
            "scale_without_presses": round(model.scale_without_presses, 4),
            "press_offset": round(model.press_offset, 4),
            "press_slope": round(model.press_slope, 4),
        }
    about = {"sensors": SENSORS, "weight_objects": WEIGHT_OBJECTS, "scale_objects": SCALE_OBJECTS}
    (WEIGHTS / "sigma.json").write_text(
        json.dumps({**about, "networks": networks}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
