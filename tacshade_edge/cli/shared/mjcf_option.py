"""``simulate --mjcf``: a sensor as files for MuJoCo."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Final

from tacshade_edge.calibration import loading
from tacshade_edge.cli.shared.options import FINITE, add_option
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import write_whole
from tacshade_edge.lab.mjcf import export
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.types import IDENTITY_POSE
from tacshade_edge.version import how_to_install

FILES: Final = (export.SENSOR_FILE, export.SCENE_FILE, "skin.msh", "taxels.msh")
_ONLY_HERE: Final = ("calibration", "mechanics")


def add_mjcf(parser: argparse.ArgumentParser) -> None:
    """Declare ``--mjcf`` and the options that state its sensor."""
    add_option(parser, "--mjcf", "DIR", "folder for the sensor as files for MuJoCo")
    text = "with --mjcf: your sensor's size, camera and flange"
    add_option(parser, "--calibration", "FILE", text)
    text = "with --mjcf: decay and friction that --fit printed"
    parser.add_argument("--mechanics", type=FINITE, nargs=2, metavar=("MM", "PART"), help=text)


def check_mjcf(args: argparse.Namespace) -> None:
    """Refuse options that only ``--mjcf`` reads, without it."""
    for name in _ONLY_HERE:
        if args.mjcf is None and getattr(args, name) is not None:
            args.parser.error(f"--{name} requires --mjcf DIR")


def write_mjcf(folder: Path, stated: SensorModel, args: argparse.Namespace) -> None:
    """Write a stated sensor, or that of ``--calibration``. Raises ConfigError and DeviceError."""
    seven: tuple[float, ...] = IDENTITY_POSE
    model = stated
    try:
        if args.calibration is not None:
            calibration = loading.load(args.calibration, store=False)
            model, seven = export.calibrated(stated, calibration), calibration.flange_T_sensor
        if args.mechanics is not None:
            decay_mm, friction = args.mechanics
            model = replace(model, skin_decay_mm=decay_mm, friction=friction)
    except ValueError as error:
        raise ConfigError(f"--mjcf: cannot simulate this sensor: {error}") from error
    x, y, z, qw, qx, qy, qz = seven
    parameters = export.Parameters(model, (x, y, z, qw, qx, qy, qz))
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in export.files(parameters).items():
        write_whole(folder / name, content)
    form = f"{model.skin} with a skin that decays over {model.skin_decay_mm:g} mm"
    print(f"{folder}: {', '.join(FILES)}: a {form}, friction {model.friction:g}")
    scene = shlex.quote(str(folder / export.SCENE_FILE))
    print(f"next: {how_to_install('mujoco')}, then\n  python -m mujoco.viewer --mjcf={scene}")
