"""``tacshade-edge simulate``: writes simulated images with ground truth, a calibration set, or a scanned touchpad."""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from tacshade_edge.cli.commands.simulate_pad import write_pad
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame, SimulatedSensor
from tacshade_edge.types import U8

REFERENCES = 8
"""Number of reference images in a calibration set."""

PRESS_KEYS = (
    *("depth_mm", "x_mm", "y_mm", "rotation_deg", "tilt_x_deg", "tilt_y_deg"),
    *("drag_x_mm", "drag_y_mm", "twist_deg"),
)
"""Values that describe a press, in ``scenes.csv`` and in the file of its ground truth."""

_SETTINGS = """\
calibration: calibration.npz
source: {kind: simulated}
recorder: {folder: recordings}
"""

_SEED_STRIDE = 1000  # so that every image of a set has a different noise seed
_PAD_SEED = 500_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for images, ground truth (.npz) and scenes.csv")
    parser.add_argument(
        "--objects",
        default=",".join(PAPER_OBJECTS),
        metavar="NAME,...",
        help=f"one or more of {', '.join(OBJECTS)}, none (default: the paper's five)",
    )
    parser.add_argument(
        "--depth", type=_number, nargs="+", default=[3.0], metavar="MM", help="press depths in mm (default: 3)"
    )
    parser.add_argument(
        "--position",
        type=_number,
        nargs=2,
        action="append",
        metavar=("X", "Y"),
        help="the object's position in mm; may be repeated (default: 0 0)",
    )
    parser.add_argument(
        "--rotation",
        type=_number,
        nargs="+",
        default=[0.0],
        metavar="DEG",
        help="rotation of the object about z in degrees (default: 0)",
    )
    for name, what in (
        ("drag", "distance in mm to drag the object along the skin after contact"),
        ("tilt", "tilt of the object in degrees, first about x, then about y"),
    ):
        parser.add_argument(
            f"--{name}",
            type=_number,
            nargs=2,
            action="append",
            metavar=("X", "Y"),
            help=f"{what}; may be repeated (default: 0 0)",
        )
    parser.add_argument(
        "--twist",
        type=_number,
        nargs="+",
        default=[0.0],
        metavar="DEG",
        help="rotation of the object about z in degrees after contact (default: 0)",
    )
    parser.add_argument(
        "--calibration-set",
        type=Path,
        metavar="DIR",
        help="write a calibration set (images of the untouched skin and of ball presses) to this folder",
    )
    parser.add_argument(
        "--presses",
        type=_count,
        default=40,
        metavar="N",
        help="number of ball presses in the calibration set (default: 40)",
    )
    parser.add_argument(
        "--pad",
        type=Path,
        metavar="DIR",
        help="simulate presses that cover a touchpad, and write their images, poses and ground truth to this folder",
    )
    parser.add_argument(
        "--pad-step",
        type=_number,
        default=4.0,
        metavar="MM",
        help="distance between presses on the touchpad in mm (default: 4)",
    )
    parser.add_argument(
        "--pad-depth",
        type=_number,
        default=2.7,
        metavar="MM",
        help="press depth in mm below the tops of the touchpad's bulges (default: 2.7)",
    )
    parser.add_argument("--pad-varied", action="store_true", help="vary the depth and tilt from press to press")
    parser.add_argument(
        "--seed", type=_count, default=0, metavar="N", help="random seed for the noise and the presses (default: 0)"
    )
    parser.add_argument(
        "--sensor-seed",
        type=_count,
        metavar="N",
        help="simulate another sensor of the family, drawn at random with this seed",
    )
    parser.set_defaults(usage_error=parser.error)


def run(args: argparse.Namespace) -> int:
    """Write the requested folders, and print a summary line for each."""
    if args.out is None and args.calibration_set is None and args.pad is None:
        args.usage_error("expected --out DIR, --calibration-set DIR or --pad DIR")
    model = SensorModel() if args.sensor_seed is None else random_model(args.sensor_seed)
    sensor = SimulatedSensor(model)
    try:
        if args.calibration_set is not None:
            _write_calibration_set(sensor, args.calibration_set, args.presses, args.seed)
        if args.out is not None:
            _write_scenes(sensor, args)
        if args.pad is not None:
            write_pad(
                model,
                args.pad,
                step_mm=args.pad_step,
                depth_mm=args.pad_depth,
                varied=args.pad_varied,
                seed=args.seed,
                noise_seed=args.seed * _SEED_STRIDE + _PAD_SEED,
                report=Progress(),
            )
    except OSError as error:
        raise DeviceError(f"{error.filename}: cannot write it: {error.strerror}") from error
    return 0


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**31:
        raise ValueError(text)
    return value


_number.__name__, _count.__name__ = "number", "whole number"  # argparse's messages show them


def _write_calibration_set(sensor: SimulatedSensor, folder: Path, count: int, seed: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    model = sensor.model
    keys: dict[str, Any] = {
        "skin_radius_mm": model.skin_radius_mm,
        **({} if model.camera_distance_mm is None else {"camera_distance_mm": model.camera_distance_mm}),
        "visible_half_angle_deg": model.visible_half_angle_deg,
        "polarity": "bright",
    }
    (folder / "SENSOR.yaml").write_text(yaml.safe_dump(keys, sort_keys=False), encoding="utf-8")
    for k in range(REFERENCES):
        _write_png(folder / f"reference_{k:02d}.png", sensor.frame((), seed * _SEED_STRIDE + k).image)
    rows = []
    progress = Progress()
    for k, (press, radius_mm) in enumerate(ball_presses(model, count, seed)):
        name = f"press_{k:03d}.png"
        _write_png(folder / name, _simulate(sensor, (press,), seed * _SEED_STRIDE + REFERENCES + k).image)
        rows.append((name, "ball", radius_mm, press.depth_mm, press.x_mm, press.y_mm))
        progress("presses", k + 1, count)
    _write_csv(folder / "PRESSES.csv", ("image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm"), rows)
    print(f"{folder}: {REFERENCES} references, {count} ball presses, SENSOR.yaml, PRESSES.csv")
    if model == SensorModel():  # the one that `source: {kind: simulated}` simulates
        (folder / "config.yaml").write_text(_SETTINGS, encoding="utf-8")
        at = shlex.quote(str(folder))
        words = f"--sensor {at}/SENSOR.yaml --reference {at}/reference_*.png --presses {at}/PRESSES.csv"
        print(f"next:\n  tacshade-edge calibrate {words} --out {at}/calibration.npz")
        print(f"  tacshade-edge run --config {at}/config.yaml")


def _write_scenes(sensor: SimulatedSensor, args: argparse.Namespace) -> None:
    names = [name.strip() for name in args.objects.split(",")]
    for name in names:
        if name not in OBJECTS and name != "none":
            raise ConfigError(f"--objects: found {name!r}, expected 'none' or one of {', '.join(OBJECTS)}")
    nowhere = [(0.0, 0.0)]
    ways = itertools.product(
        args.depth, args.position or nowhere, args.rotation, args.tilt or nowhere, args.drag or nowhere, args.twist
    )
    presses = [(depth, x, y, rotation, *tilt, *drag, twist) for depth, (x, y), rotation, tilt, drag, twist in ways]
    scenes = [(name, each) for name in names for each in (presses if name != "none" else [(0.0,) * len(PRESS_KEYS)])]
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    progress = Progress()
    for k, (name, numbers) in enumerate(scenes):
        known = dict(zip(PRESS_KEYS, numbers, strict=True))
        pressed = () if name == "none" else (Press(OBJECTS[name](), **known),)
        frame = _simulate(sensor, pressed, args.seed * _SEED_STRIDE + k)
        stem = f"{k:03d}_{name}"
        _write_png(args.out / f"{stem}.png", frame.image)
        depth_max_mm = _write_truth(args.out / f"{stem}.npz", frame, name, known)
        rows.append((f"{stem}.png", name, *numbers, round(depth_max_mm, 4)))
        progress("images", k + 1, len(scenes))
    _write_csv(args.out / "scenes.csv", ("image", "object", *PRESS_KEYS, "depth_max_mm"), rows)
    print(f"{args.out}: {len(scenes)} images with ground truth, scenes.csv")


def _simulate(sensor: SimulatedSensor, presses: tuple[Press, ...], noise_seed: int) -> SimulatedFrame:
    try:
        return sensor.frame(presses, noise_seed)
    except ValueError as error:
        raise ConfigError(f"cannot simulate: {error}") from error


def _write_truth(path: Path, frame: SimulatedFrame, name: str, known: Mapping[str, float]) -> float:
    truth = frame.truth()
    shear_mm = np.full((*truth.height_mm.shape, 2), np.nan, np.float32)
    inside = np.nonzero(np.isfinite(truth.height_mm))
    shear_mm[inside] = frame.shear_mm(inside[0].astype(float), inside[1].astype(float)) if frame.presses else 0.0
    content: dict[str, Any] = {
        "height_mm": truth.height_mm,
        "contact": truth.contact,
        "row0": 0.0,
        "col0": 0.0,
        "step_px": 1.0,
        "points_mm": truth.points_mm,
        "object_points_mm": truth.object_points_mm,
        "depth_max_mm": truth.depth_max_mm,
        "shear_mm": shear_mm,
        "object": name,
        **known,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    path.write_bytes(buffer.getvalue())
    return truth.depth_max_mm


def _write_png(path: Path, image: U8) -> None:
    path.write_bytes(cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 3))[1].tobytes())


def _write_csv(path: Path, header: tuple[str, ...], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
