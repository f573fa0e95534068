"""``tacshade-edge calibrate``: makes a calibration file from references and known presses, or renews its reference."""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacshade_edge.cli.commands.calibrate_labels import learn_from_labels, touch_report, touch_warnings
from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import KnownPress, Sensor
from tacshade_edge.core.calibration.observation.touches import from_travel
from tacshade_edge.core.calibration.quality import Quality
from tacshade_edge.core.calibration.recalibration import inputs_of, with_new_reference
from tacshade_edge.core.calibration.reference.references import rezero
from tacshade_edge.core.frame_check import registration
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.factories import calibrations
from tacshade_edge.inference.network import load_networks
from tacshade_edge.inference.touch_learning import report_lines
from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.tables.indenters import read_indenters
from tacshade_edge.storage.tables.labels import read_labels
from tacshade_edge.storage.tables.presses import read_presses
from tacshade_edge.types import U8, Calibration
from tacshade_edge.version import how_to_install

if TYPE_CHECKING:
    from tacshade_edge.fitting.fit import FitResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument(
        "--sensor", type=Path, metavar="SENSOR.yaml", help="file that describes the sensor's dimensions and camera"
    )
    kind.add_argument(
        "--rezero", type=Path, metavar="CAL.npz", help="replace only the reference in this calibration file"
    )
    parser.add_argument(
        "--reference",
        type=Path,
        required=True,
        nargs="+",
        metavar="IMG",
        help="at least 5 images of the untouched skin",
    )
    parser.add_argument(
        "--presses", type=Path, metavar="PRESSES.csv", help="calibrate depth in mm with the known presses in this table"
    )
    parser.add_argument(
        "--indenters",
        type=Path,
        metavar="INDENTERS.yaml",
        help="file that defines every indenter in PRESSES.csv that is not a ball",
    )
    parser.add_argument(
        "--depth-from-touch", action="store_true", help="treat depth_mm in PRESSES.csv as travel from first touch"
    )
    parser.add_argument(
        "--fit",
        action="store_true",
        help="also train the networks on simulated frames of this sensor; takes minutes and needs the `fit` extra",
    )
    parser.add_argument(
        "--labels",
        type=Path,
        metavar="LABELS.csv",
        help="learn depth, tilt, shear, forces and so on from the labelled frames in this table",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="CAL.npz", help="calibration file to write")
    parser.add_argument(
        "--allow-loaded-reference",
        action="store_true",
        help="warn, but do not stop, if something seems to be pressing on the skin in the reference images",
    )
    parser.add_argument("--json", action="store_true", help="print the fitted values as JSON")
    parser.set_defaults(usage_error=parser.error)


def run(args: argparse.Namespace) -> int:
    """Fit or re-zero, write the calibration file, and print its quality."""
    if args.rezero is not None:
        if args.presses or args.indenters:
            given = "--presses" if args.presses else "--indenters"
            args.usage_error(f"{given} has no effect with --rezero, which keeps the fit to the presses")
        if args.labels:
            args.usage_error("--labels has no effect with --rezero, which keeps the touch model")
        if args.fit:
            args.usage_error("--fit has no effect with --rezero, which keeps the fit to the presses")
        return _rezero(args)
    if args.depth_from_touch and not args.presses:
        args.usage_error("--depth-from-touch has no effect without --presses")
    fit = _fit() if args.fit else None
    sensor = read_sensor(args.sensor)
    references = _read_references(args.reference)
    if args.indenters and not args.presses:
        args.usage_error("--indenters has no effect without --presses, which name them")
    labelled = read_labels(args.labels, args.labels.parent) if args.labels else []
    indenters = read_indenters(args.indenters) if args.indenters else {}
    presses, notes = read_presses(args.presses, indenters) if args.presses else ([], ())
    if args.presses and not presses:
        raise ConfigError(f"{args.presses}: found no press, expected at least one")
    if args.depth_from_touch:
        presses, above = _from_travel(presses, sensor)
        notes = (*notes, *above)
    try:
        result = calibrate(
            sensor, references, presses, args.allow_loaded_reference, load_networks(), list(map(str, args.reference))
        )
    except ConfigError as error:
        raise ConfigError(_by_path(str(error), args)) from None
    folder = args.out.with_name(f"{args.out.name}.fit")
    fitted = fit(result.calibration, result.presses, _say, sensor.print_mm, folder) if fit else None
    calibration = fitted.calibration if fitted else result.calibration
    touch = learn_from_labels(calibration, args.labels, labelled) if labelled else ()
    learnt = {one.profile: one.learnt.model for one in touch if one.learnt.model is not None}
    calibration = replace(calibration, touch=learnt)
    stored = calibration_file.save(args.out, calibration, inputs_of(sensor, references, presses))
    _print(
        args,
        stored,
        (*notes, *result.warnings, *touch_warnings(touch)),
        _quality(result.quality) | _fitted(fitted) | touch_report(touch),
    )
    if not args.json:
        for line in (line for one in touch for line in report_lines(one)):
            print(line)
        print(f"{'as shipped, ' if fitted else ''}{result.quality.line}")
        for line in (*fitted.found, *(report.line for report in fitted.networks)) if fitted else ():
            print(line)
        for advice in (*(fitted.advice if fitted else ()), *result.quality.advice):
            print(f"  to do: {advice}")
    return 0


def _from_travel(presses: Sequence[KnownPress], sensor: Sensor) -> tuple[list[KnownPress], tuple[str, ...]]:
    """Return the presses with their depth instead of their travel, and a warning for each left out as it has none."""
    converted = [from_travel(press, sensor.skin_radius_mm) for press in presses]
    why = "after that travel its lowest point is still above the skin at (x, y); left out"
    above = tuple(f"{press.name}: {why}" for press in converted if press.depth_mm <= 0)
    return [press for press in converted if not press.depth_mm <= 0], above


def _fit() -> Callable[..., FitResult]:
    """Return the function that trains. Raises ConfigError if the extra is not installed."""
    for module, name in (("torch", "PyTorch"), ("numba", "numba")):  # large, and needed only here
        if importlib.util.find_spec(module) is None:
            raise ConfigError(f"--fit: {name} is not installed; to install it: {how_to_install('fit')}")
    from tacshade_edge.fitting.fit import fit

    return fit


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _fitted(fitted: FitResult | None) -> dict[str, Any]:
    """Return the result of the fit for ``--json``."""
    if fitted is None:
        return {}
    reports = {
        report.name: {key: value for key, value in asdict(report).items() if key != "name"} | {"kept": report.kept}
        for report in fitted.networks
    }
    return {"fitted": reports, "fit_found": list(fitted.found), "fit_to_do": list(fitted.advice)}


def _by_path(text: str, args: argparse.Namespace) -> str:
    """Replace a file's generic name, which errors about the whole file contain, with its path."""
    paths = {"SENSOR.yaml": str(args.sensor), "PRESSES.csv": str(args.presses)}
    return re.sub(r"(?<![\w/])(SENSOR\.yaml|PRESSES\.csv)(?=: )", lambda name: paths[name[0]], text)


def _rezero(args: argparse.Namespace) -> int:
    old, inputs = calibrations.load(args.rezero), calibration_file.inputs_in(args.rezero)
    images = _read_references(args.reference)
    try:
        renewed = rezero(old, images, args.allow_loaded_reference, list(map(str, args.reference)))
        # Keep even networks that cannot run: `doctor` then suggests a new fit.
        renewed = replace(renewed, fitted=calibration_file.fitted_in(args.rezero))
    except ConfigError as error:
        raise ConfigError(f"{args.rezero}: {error}") from None
    disc = old.geometry.disc
    found = registration.drift(registration.look(old.reference_grey, disc, old.pitch_px), renewed.reference_grey)
    changes = (registration.shift_reason(found, disc), registration.light_drift_reason(found))
    warnings = [f"{change} since {args.rezero}" for change in changes if change]
    changed = {
        "moved_px": round(found.moved_px, 2),
        "light": round(found.light, 3),
        "contrast": round(found.contrast, 3),
    }
    stored = calibration_file.save(args.out, renewed, inputs and with_new_reference(inputs, images))
    _print(args, stored, warnings, changed)
    return 0


def _read_references(paths: Sequence[Path]) -> list[U8]:
    try:
        references = [read_image(path) for path in paths]
    except DecodeError as error:
        raise ConfigError(f"--reference: {error}") from None
    height, width = references[0].shape[:2]
    for path, image in zip(paths, references, strict=True):
        if image.shape[:2] != (height, width):
            found = f"{image.shape[1]}x{image.shape[0]} px"
            raise ConfigError(
                f"--reference: {path}: found {found}, expected {width}x{height} px as in the first reference"
            )
    return references


def _print(args: argparse.Namespace, stored: Calibration, warnings: Sequence[str], more: dict[str, Any]) -> None:
    report = _report(stored)
    if args.json:
        print(json.dumps(report | more | {"warnings": list(warnings)}, indent=2))
        return
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"{args.out}: calibration {stored.crc32:08x}")
    shown = report | {key: value for key, value in more.items() if isinstance(value, float)}
    for key, value in shown.items():
        if key != "crc32":
            print(f"  {key}: {value:.4g}" if isinstance(value, float) else f"  {key}: {value}")


def _quality(quality: Quality) -> dict[str, Any]:
    """Return the quality for ``--json``."""
    return {"verdict": quality.grade, "verdict_line": quality.line, "to_do": list(quality.advice)}


def _report(calibration: Calibration) -> dict[str, Any]:
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
        **{key: round(value, 4) for key, value in calibration_file.fit_figures(calibration.fit).items()},
    }
