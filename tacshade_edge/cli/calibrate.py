"""``tacshade-edge calibrate``: references and ball presses to a calibration file."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from tacshade_edge.core.calibrate import calibrate
from tacshade_edge.devices import calibration_file
from tacshade_edge.devices.images import read_image
from tacshade_edge.devices.presses import read_presses
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.types import Calibration


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--sensor", type=Path, required=True, metavar="SENSOR.yaml", help="what is known of the sensor")
    parser.add_argument(
        "--reference", type=Path, required=True, nargs="+", metavar="IMG", help="images of the unloaded skin, 5 or more"
    )
    parser.add_argument("--presses", type=Path, metavar="PRESSES.csv", help="known ball presses, for metric depth")
    parser.add_argument("--out", type=Path, required=True, metavar="CAL.npz", help="the calibration to write")
    parser.add_argument(
        "--allow-loaded-reference", action="store_true", help="warn only when the reference seems taken under load"
    )
    parser.add_argument("--json", action="store_true", help="print what was fitted as JSON")


def run(args: argparse.Namespace) -> int:
    """Fit, write, and say how good it is."""
    sensor = read_sensor(args.sensor)
    try:
        references = [read_image(path) for path in args.reference]
    except DecodeError as error:
        raise ConfigError(f"--reference: {error}") from None
    height, width = references[0].shape[:2]
    for path, image in zip(args.reference, references, strict=True):
        if image.shape[:2] != (height, width):
            found = f"{image.shape[1]}x{image.shape[0]} px"
            raise ConfigError(f"--reference: {path}: found {found}, expected {width}x{height} px as the first")
    presses = read_presses(args.presses) if args.presses else []
    if args.presses and not presses:
        raise ConfigError(f"{args.presses}: found no press, expected a row for each")
    result = calibrate(sensor, references, presses, args.allow_loaded_reference)
    stored = calibration_file.save(args.out, result.calibration)
    report = _report(stored, list(result.warnings))
    if args.json:
        print(json.dumps(report, indent=2))
        return 0
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"{args.out}: calibration {stored.crc32:08x}")
    for key, value in report.items():
        if key not in ("warnings", "crc32"):
            print(f"  {key}: {value:.4g}" if isinstance(value, float) else f"  {key}: {value}")
    if not presses:
        print("  depth is not calibrated: without --presses it is the paper's α times a normalised height")
    return 0


def _report(calibration: Calibration, warnings: list[str]) -> dict[str, Any]:
    geometry = calibration.geometry
    return {
        "crc32": f"{calibration.crc32:08x}",
        "row_c": round(geometry.disc.row_c, 3),
        "col_c": round(geometry.disc.col_c, 3),
        "radius_px": round(geometry.disc.radius_px, 3),
        "mm_per_px": round(geometry.mm_per_px, 6),
        "f_px": round(geometry.f_px, 3),
        "pitch_px": round(calibration.pitch_px, 3),
        "noise_grey": round(calibration.noise_grey, 3),
        "alpha": round(calibration.alpha, 3),
        **{key: round(value, 4) for key, value in calibration.fit.items() if math.isfinite(value)},
        "warnings": warnings,
    }
