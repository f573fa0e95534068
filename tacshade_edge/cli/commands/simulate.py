"""``tacshade-edge simulate``: writes simulated images with ground truth, a calibration set,
a scanned touchpad, or the sensor for MuJoCo.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import functools
import itertools
import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml

from tacshade_edge.calibration.files import press_table
from tacshade_edge.cli.shared.mjcf_option import FILES, add_mjcf, check_mjcf, write_mjcf
from tacshade_edge.cli.shared.options import COUNT, FINITE, NEXT_FIT, add_cluster, add_option, need
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import disk_errors
from tacshade_edge.files.images import png
from tacshade_edge.files.targets import check_folder, owned_folder
from tacshade_edge.lab.parallel import reported_map, workers
from tacshade_edge.lab.simulator import pad as pads
from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS, Press
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened, random_model
from tacshade_edge.lab.simulator.tacshade import OBJECT_SCALE, TACSHADE
from tacshade_edge.lab.simulator.truth import SimulatedFrame, SimulatedSensor
from tacshade_edge.quoting import counted
from tacshade_edge.recording import frame_table
from tacshade_edge.rigid import from_seven
from tacshade_edge.types import Skin

MODELS = ("default", "tacshade")
REFERENCES = 8
"""Number of reference images in a calibration set."""
PRESS_KEYS = (
    "depth_mm",
    "x_mm",
    "y_mm",
    "rotation_deg",
    "tilt_x_deg",
    "tilt_y_deg",
    "drag_x_mm",
    "drag_y_mm",
    "twist_deg",
)
"""Values that describe a press, in ``scenes.csv`` and in the file of its ground truth."""

_SETTINGS = """\
calibration: calibration.npz
source: {kind: simulated}
recorder: {folder: recordings}
"""
_NO_OBJECT = "none"
# So that every image of a set has a noise seed of its own.
_SEED_STRIDE = 1000
# Deep: the skin has to reach below the tops of the pad's bulges.
_PAD_SEED, _PAD_DEPTH_MM = 500_000, 2.7
_PAD_STEP_LEAST_MM, _PAD_STEP_MOST_MM = 0.5, 20.0
_TRUTH_STEP_MM = 0.25
# Standard deviations of the noise in POSES_NOISY.csv:
# along each axis, and about a random one through the skin's apex.
_NOISE_MM, _NOISE_DEG = 0.3, 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "--out", "DIR", "folder for images, ground truth (.npz) and scenes.csv")
    text = "such as ball,none (default: the paper's five)"
    add_option(parser, "--objects", "NAME,...", text, str, default=",".join(PAPER_OBJECTS))
    for name, metavar, default, text in (
        ("--depth", "MM", 3.0, "depths in mm (default: 3)"),
        ("--rotation", "DEG", 0.0, "rotations about z in degrees (default: 0)"),
        ("--twist", "DEG", 0.0, "turns about z after contact in degrees (default: 0)"),
    ):
        add_option(parser, name, metavar, text, FINITE, nargs="+", default=[default])
    for name, text in (
        ("--position", "the object's place in mm"),
        ("--drag", "drag after contact in mm"),
        ("--tilt", "tilt about x, y in degrees"),
    ):
        text += "; repeatable (default: 0 0)"
        parser.add_argument(
            name, type=FINITE, nargs=2, action="append", metavar=("X", "Y"), help=text
        )
    add_option(
        parser,
        "--calibration-set",
        "DIR",
        "folder for references and images of ball presses",
    )
    add_option(
        parser,
        "--presses",
        "N",
        "ball presses in the calibration set (default: 40)",
        COUNT,
        default=40,
    )
    add_option(parser, "--pad", "DIR", "folder for presses on a touchpad, with poses and truth")
    add_option(
        parser,
        "--pad-step",
        "MM",
        "distance between the pad's presses in mm (default: 4)",
        FINITE,
        default=4.0,
    )
    add_option(
        parser, "--seed", "N", "seed of the noise and the presses (default: 0)", COUNT, default=0
    )
    _add_sensor_options(parser)
    add_mjcf(parser)
    add_cluster(parser)


def _add_sensor_options(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group()
    add_option(
        which, "--sensor-seed", "N", "another sensor of the family, drawn with this seed", COUNT
    )
    which.add_argument(
        "--model",
        choices=MODELS,
        metavar="NAME",
        default=MODELS[0],
        help="default, or tacshade, which gives Table I",
    )
    parser.add_argument(
        "--skin",
        choices=get_args(Skin),
        metavar="FORM",
        default="dome",
        help="dome (default), or pad, the same but flat",
    )


def run(args: argparse.Namespace) -> int:
    if not _folders(args):
        args.parser.error("expected --out DIR, --calibration-set DIR, --pad DIR or --mjcf DIR")
    check_mjcf(args)
    if args.cluster is not None and args.pad is None:
        args.parser.error("--cluster requires --pad: the other images take seconds")
    if args.cluster is not None:
        need("--cluster", "cluster", "dask", "distributed")  # before the other images
    model = _model(args.model, args.sensor_seed)
    model = flattened(model) if args.skin == "pad" else model
    _check(args)
    with contextlib.ExitStack() as stack:
        # Two of them may be the same.
        for folder in {os.path.realpath(path) for path in _folders(args)}:
            stack.enter_context(owned_folder(Path(folder), "simulate"))
        stack.enter_context(disk_errors(Path()))
        if args.mjcf is not None:
            write_mjcf(args.mjcf, model, args)
            if _folders(args) == [args.mjcf]:
                return 0
        sensor = SimulatedSensor(model)
        if args.calibration_set is not None:
            _write_calibration_set(sensor, args.calibration_set, args.presses, args.seed)
        try:
            if args.out is not None:
                _write_scenes(sensor, args)
        # Only the simulator knows which presses it can draw.
        except ValueError as error:
            raise ConfigError(f"cannot simulate: {error}") from error
        if args.pad is not None:
            write_pad(model, args.pad, args.pad_step, _PAD_DEPTH_MM, args.seed, args.cluster)
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse what would end the command after some of its work: unknown objects, a step that is too
    short or too long, folders that cannot be written. Raises ConfigError and DeviceError.
    """
    for name in _names(args) if args.out is not None else ():
        if name not in OBJECTS and name != _NO_OBJECT:
            raise ConfigError(
                f"--objects: found {name!r}, expected {_NO_OBJECT!r} or one of {', '.join(OBJECTS)}"
            )
    if args.pad is not None:
        _check_step(args.pad_step)
    for folder, names in (
        (args.calibration_set, ("SENSOR.yaml", "PRESSES.csv", "config.yaml")),
        (args.out, ("scenes.csv",)),
        (args.pad, ("SENSOR.yaml", "POSES.csv", "POSES_NOISY.csv", "PAD.npz")),
        (args.mjcf, FILES),
    ):
        if folder is not None:
            check_folder(folder, names)


def _folders(args: argparse.Namespace) -> list[Path]:
    paths = (args.calibration_set, args.out, args.pad, args.mjcf)
    return [path for path in paths if path is not None]


def _names(args: argparse.Namespace) -> list[str]:
    return [name.strip() for name in args.objects.split(",")]


def _check_step(step_mm: float) -> None:
    if not _PAD_STEP_LEAST_MM <= step_mm <= _PAD_STEP_MOST_MM:
        expected = f"expected {_PAD_STEP_LEAST_MM:g} to {_PAD_STEP_MOST_MM:g} mm"
        raise ConfigError(f"--pad-step: found a step of {step_mm:g} mm, {expected}")


def _model(name: str, sensor_seed: int | None) -> SensorModel:
    if sensor_seed is not None:
        return random_model(sensor_seed)
    return SensorModel() if name == MODELS[0] else TACSHADE


def _write_sensor(model: SensorModel, folder: Path) -> None:
    names = ("skin_radius_mm", "camera_distance_mm", "visible_half_angle_deg")
    stated = {name: getattr(model, name) for name in names}
    if model.skin == "pad":
        radius_mm = round(model.geometry.visible_radius_mm, 4)
        stated = {"skin": "pad", "visible_radius_mm": radius_mm, names[1]: stated[names[1]]}
    keys = {name: value for name, value in stated.items() if value is not None} | {
        "polarity": "bright"
    }
    (folder / "SENSOR.yaml").write_text(yaml.safe_dump(keys, sort_keys=False), encoding="utf-8")


def _write_references(sensor: SimulatedSensor, folder: Path, seed: int) -> None:
    for k in range(REFERENCES):
        (folder / f"reference_{k:02d}.png").write_bytes(
            png(sensor.frame((), seed * _SEED_STRIDE + k).image)
        )


def _calibrate(at: str, more: str) -> str:
    words = f"calibrate --sensor {at}/SENSOR.yaml --reference {at}/reference_*.png"
    return f"  tacshade-edge {words}{more} --out {at}/calibration.npz"


def _write_calibration_set(sensor: SimulatedSensor, folder: Path, count: int, seed: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    model = sensor.model
    _write_sensor(model, folder)
    _write_references(sensor, folder, seed)
    rows, progress = [], Progress()
    for k, (press, radius_mm) in enumerate(ball_presses(model, count, seed)):
        name = f"press_{k:03d}.png"
        image = sensor.frame((press,), seed * _SEED_STRIDE + REFERENCES + k).image
        (folder / name).write_bytes(png(image))
        rows.append((name, press_table.BALL, radius_mm, press.depth_mm, press.x_mm, press.y_mm))
        progress("presses", k + 1, count)
    _write_csv(folder / "PRESSES.csv", press_table.HEADER, rows)
    print(
        f"{folder}: {REFERENCES} references, {counted(count, 'ball press')}, SENSOR.yaml, "
        "PRESSES.csv"
    )
    at = shlex.quote(str(folder))
    print(NEXT_FIT)
    print(_calibrate(at, f" --presses {at}/PRESSES.csv --fit"))
    # The one that `source: {kind: simulated}` simulates.
    if model == SensorModel():
        (folder / "config.yaml").write_text(_SETTINGS, encoding="utf-8")
        print(f"  tacshade-edge run --config {at}/config.yaml")


def _write_scenes(sensor: SimulatedSensor, args: argparse.Namespace) -> None:
    nowhere = [(0.0, 0.0)]
    places, tilts, drags = (given or nowhere for given in (args.position, args.tilt, args.drag))
    ways = itertools.product(args.depth, places, args.rotation, tilts, drags, args.twist)
    pressed = [
        (depth, x, y, rotation, *tilt, *drag, twist)
        for depth, (x, y), rotation, tilt, drag, twist in ways
    ]
    scenes = [
        (name, each)
        for name in _names(args)
        for each in (pressed if name != _NO_OBJECT else [(0.0,) * len(PRESS_KEYS)])
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    rows, progress = [], Progress()
    scale = 1.0 if args.model == MODELS[0] else OBJECT_SCALE
    for k, (name, numbers) in enumerate(scenes):
        known = dict(zip(PRESS_KEYS, numbers, strict=True))
        objects = () if name == _NO_OBJECT else (Press(OBJECTS[name](), **known, scale=scale),)
        frame = sensor.frame(objects, args.seed * _SEED_STRIDE + k)
        stem = f"{k:03d}_{name}"
        (args.out / f"{stem}.png").write_bytes(png(frame.image))
        depth_max_mm = _write_truth(args.out / f"{stem}.npz", frame, name, known)
        rows.append((f"{stem}.png", name, *numbers, round(depth_max_mm, 4)))
        progress("images", k + 1, len(scenes))
    _write_csv(args.out / "scenes.csv", ("image", "object", *PRESS_KEYS, "depth_max_mm"), rows)
    print(f"{args.out}: {counted(len(scenes), 'image')} with ground truth, scenes.csv")
    at = shlex.quote(str(args.out))
    seed = "" if args.sensor_seed is None else f" --sensor-seed {args.sensor_seed}"
    seed += "" if args.model == MODELS[0] else f" --model {args.model}"
    seed += "" if args.skin == "dome" else f" --skin {args.skin}"
    print(f"next:\n  tacshade-edge simulate --calibration-set {at}/sensor{seed}")
    print(_calibrate(f"{at}/sensor", f" --presses {at}/sensor/PRESSES.csv"))
    print(f"  tacshade-edge evaluate --images {at} --calibration {at}/sensor/calibration.npz")


def _write_truth(path: Path, frame: SimulatedFrame, name: str, known: Mapping[str, float]) -> float:
    truth = frame.truth()
    shear_mm = np.full((*truth.height_mm.shape, 2), np.nan, np.float32)
    inside = np.nonzero(np.isfinite(truth.height_mm))
    shear_mm[inside] = (
        frame.shear_mm(inside[0].astype(float), inside[1].astype(float)) if frame.presses else 0.0
    )
    names = ("height_mm", "contact", "points_mm", "object_points_mm", "depth_max_mm")
    content: dict[str, Any] = {name: getattr(truth, name) for name in names}
    content |= {
        "row0": 0.0,
        "col0": 0.0,
        "step_px": 1.0,
        "shear_mm": shear_mm,
        "object": name,
        **known,
    }
    np.savez_compressed(path, **content)
    return truth.depth_max_mm


def _write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def write_pad(
    model: SensorModel,
    folder: Path,
    step_mm: float,
    depth_mm: float,
    seed: int,
    cluster: str | None = None,
) -> None:
    """Press all over the paper's touchpad (Fig. 7): images, poses, references and the truth.

    Raises OSError.
    """
    pad, apex_mm = pads.touchpad(), model.geometry.apex_z_mm
    _check_step(step_mm)
    poses = pads.scan(pad, step_mm, depth_mm, apex_mm)
    folder.mkdir(parents=True, exist_ok=True)
    # Without flange_T_sensor: sensor and flange coincide, as in the poses below.
    _write_sensor(model, folder)
    _write_references(_sensor(model), folder, seed)
    names = [f"press_{k:04d}.png" for k in range(len(poses))]
    # Away from the noise of the references, whose seed is the same.
    noise_seed = seed * _SEED_STRIDE + _PAD_SEED
    tasks = [(model, pose.seven(), noise_seed + k) for k, pose in enumerate(poses)]
    with workers(cluster) as pool:
        for name, data in zip(
            names, reported_map(_image, tasks, pool, Progress(), "presses"), strict=True
        ):
            (folder / name).write_bytes(data)
    # What a robot states is never exact; with these, a refinement has something to do.
    noisy = pads.disturbed(poses, apex_mm, _NOISE_MM, _NOISE_DEG, seed)
    for table, stated in (("POSES.csv", poses), ("POSES_NOISY.csv", noisy)):
        rows = [
            (name, *(f"{v:.6f}" for v in pose.seven()))
            for name, pose in zip(names, stated, strict=True)
        ]
        _write_csv(folder / table, frame_table.POSES_HEADER, rows)
    true_mm = pads.raster(pad, _TRUTH_STEP_MM)
    np.savez_compressed(
        folder / "PAD.npz", z_mm=true_mm, x0_mm=0.0, y0_mm=0.0, step_mm=_TRUTH_STEP_MM
    )
    made = f"POSES.csv, POSES_NOISY.csv, PAD.npz, {REFERENCES} references, SENSOR.yaml"
    print(f"{folder}: {counted(len(poses), 'press')}, {made}")
    at = shlex.quote(str(folder))
    print(f"next:\n{_calibrate(at, '')}")
    print(
        f"  tacshade-edge stitch --calibration {at}/calibration.npz --poses {at}/POSES.csv", end=" "
    )
    print(f"--truth {at}/PAD.npz --out {at}/map")


@functools.cache
def _sensor(model: SensorModel) -> SimulatedSensor:
    return SimulatedSensor(model)


def _image(task: tuple[SensorModel, tuple[float, ...], int]) -> bytes:
    """Return the image of a press as the bytes of a PNG file."""
    model, pose, noise_seed = task
    shape = pads.touchpad().under(from_seven(pose), model.geometry.apex_z_mm)
    return png(_sensor(model).frame((Press(shape, 0.0, 0.0, 0.0),), noise_seed).image)
