"""``tacshade-edge calibrate``: makes a calibration file from references, presses and labels,
or renews a reference.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.calibrate import (
    CalibrationResult,
    calibrate,
    inputs_of,
    with_new_reference,
)
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.files.indenter_file import read_indenters
from tacshade_edge.calibration.files.labels import read_labels
from tacshade_edge.calibration.files.press_table import read_presses
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.calibration.indenters import skin_z_mm
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.calibration.press_machine import from_travel
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.calibration.reference.visible_circle import CircleNotFoundError
from tacshade_edge.calibration.sentences import FindingError, sentence
from tacshade_edge.cli import EXIT_FAILED, EXIT_OK
from tacshade_edge.cli.shared.finding_options import WITH_OPTIONS
from tacshade_edge.cli.shared.fit_option import (
    check_fit,
    fit_report,
    kept_until_written,
    read_touches,
)
from tacshade_edge.cli.shared.label_option import (
    check_labelled,
    learn_touches,
    touch_models,
    touch_report,
    touch_warnings,
)
from tacshade_edge.cli.shared.options import add_flag, add_option
from tacshade_edge.cli.shared.rest_option import (
    add_rest,
    check_rest,
    rest_lines,
    rest_of,
    rest_report,
    rest_warnings,
)
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors
from tacshade_edge.files.drawing import reference_picture, write_picture
from tacshade_edge.files.images import images_in, read_image, size_text
from tacshade_edge.files.targets import check_file, one_at_a_time
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.sensor.frame_check import camera_drift
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import TouchResult, load_networks, report_lines
from tacshade_edge.sensor.inference.rest_evidence import LearntRest
from tacshade_edge.sensor.profiles import DEFAULT
from tacshade_edge.types import U8, Calibration, Geometry

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.fit import FitResult

# Options that have no effect with ``--rezero``, and what that keeps.
_WITH_REZERO = dict.fromkeys(
    ("presses", "indenters", "fit", "touches"), "the fit to the presses"
) | {"labels": "the touch model"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kind = parser.add_mutually_exclusive_group(required=True)
    add_option(
        kind, "--sensor", "SENSOR.yaml", "file that describes the sensor's dimensions and camera"
    )
    add_option(kind, "--rezero", "CAL.npz", "replace only the reference in this calibration file")
    text = "5 or more images of the untouched skin, or folders"
    add_option(parser, "--reference", "IMG", text, required=True, nargs="+")
    add_option(
        parser,
        "--presses",
        "PRESSES.csv",
        "calibrate depth in mm with the known presses in this table",
    )
    add_option(
        parser, "--indenters", "INDENTERS.yaml", "the indenters in PRESSES.csv that are no balls"
    )
    add_flag(
        parser, "--depth-from-touch", "treat depth_mm in PRESSES.csv as travel from first touch"
    )
    add_flag(
        parser,
        "--fit",
        "also train the networks on a simulated twin: minutes, with the extra `fit`",
    )
    text = (
        "pictures of touches without labels, or folders: they choose the twin of --fit and judge it"
    )
    add_option(parser, "--touches", "IMG", text, nargs="+")
    add_option(
        parser, "--labels", "LABELS.csv", "learn quantities from this table's labelled frames"
    )
    add_rest(parser)
    add_option(parser, "--out", "CAL.npz", "calibration file to write", required=True)
    add_option(
        parser,
        "--plot",
        "FILE.png",
        "draw what was found on the reference, or only its axes if it is refused",
    )
    add_flag(
        parser, "--allow-loaded-reference", "only warn if the skin seems pressed in a reference"
    )
    add_flag(parser, "--json", "print the fitted values as JSON")


def run(args: argparse.Namespace) -> int:
    """Fit or re-zero, write the calibration file, and print its quality."""
    _check_options(args)
    _check_outputs(args)
    with one_at_a_time(args.out, "calibrate", "fitting into" if args.fit else "writing"):
        return _make(args) if args.rezero is None else _rezero(args)


def _make(args: argparse.Namespace) -> int:
    args.reference = images_in(args.reference)
    sensor, references = read_sensor(args.sensor), _read_references(args.reference)
    if args.fit:
        check_fit(args.sensor, sensor, args.out)
    # Whatever is to be read is read before the minutes that a fit takes.
    touches = read_touches(args.touches, references[0]) if args.touches else []
    labelled = read_labels(args.labels, args.labels.parent) if args.labels else []
    presses, notes = _presses(args, sensor.skin_radius_mm) if args.presses else ([], ())
    if labelled:
        check_labelled(args.labels, labelled, size_text(references[0]))
    if args.rest:
        check_rest(args.rest)
    with kept_until_written(args.out) if args.fit else contextlib.nullcontext() as kept:
        result = _calibrate(args, sensor, references, presses)
        fitted = kept.run(sensor, result, touches) if kept else None
        calibration = fitted.calibration if fitted else result.calibration
        touch = learn_touches(calibration, args.labels, labelled) if labelled else []
        # Learnt with the fitted networks, whose heights at rest are others than as shipped.
        rest = rest_of(args, calibration, references) if args.rest else None
        calibration = replace(
            calibration,
            touch=touch_models(touch) if touch else {},
            rest=rest.limits if rest else {},
        )
        inputs = inputs_of(sensor, references, presses)
        stored = calibration_file.save(args.out, calibration, inputs)
    made = _Made(calibration, result, fitted, touch, rest)
    found = (sentence(warning, WITH_OPTIONS) for warning in result.warnings)
    warnings = (*notes, *found, *(touch_warnings(touch) if touch else ()))
    _print(args, stored, (*warnings, *(rest_warnings(rest) if rest else ())), _report(made))
    if not args.json:
        _print_lines(made)
    return EXIT_FAILED if fitted and not fitted.networks else EXIT_OK


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """A new calibration, and all that is reported of how it was made."""

    calibration: Calibration
    result: CalibrationResult
    fitted: FitResult | None
    touch: Sequence[TouchResult]
    rest: LearntRest | None


def _check_options(args: argparse.Namespace) -> None:
    """End with a usage error if an option would have no effect."""
    if args.false_contacts is not None and args.rest is None:
        args.parser.error("--false-contacts has no effect without --rest")
    if args.rezero is not None:
        for option, kept in _WITH_REZERO.items():
            if getattr(args, option):
                args.parser.error(f"--{option} has no effect with --rezero, which keeps {kept}")
        return
    for option in ("depth_from_touch", "indenters"):
        if getattr(args, option) and not args.presses:
            args.parser.error(f"--{option.replace('_', '-')} has no effect without --presses")
    if args.touches and not args.fit:
        args.parser.error("--touches has no effect without --fit")


def _check_outputs(args: argparse.Namespace) -> None:
    """Refuse files that could not be written. Raises DeviceError."""
    for path in filter(None, (args.out, args.plot)):
        check_file(path)


def _calibrate(
    args: argparse.Namespace,
    sensor: StatedSensor,
    references: Sequence[U8],
    presses: Sequence[KnownPress],
) -> CalibrationResult:
    """Calibrate with the networks as shipped, and draw what was found, if so asked."""
    try:
        result = calibrate(
            sensor,
            references,
            presses,
            allow_loaded_reference=args.allow_loaded_reference,
            networks=load_networks(),
            reference_names=list(map(str, args.reference)),
        )
    except ConfigError as error:
        if args.plot:
            # The picture with its axes is what a person needs to state the circle.
            guess = error.guess if isinstance(error, CircleNotFoundError) else None
            _plot(args.plot, reference_picture(to_grey(references[0]), guess=guess))
        if not isinstance(error, FindingError):
            raise
        wording = replace(WITH_OPTIONS, sensor_file=str(args.sensor), press_table=str(args.presses))
        raise error.worded(wording) from None
    if args.plot:
        made = result.calibration
        places = places_px(made.geometry, result.presses)
        _plot(args.plot, reference_picture(made.reference_grey, made, places))
    return result


def _plot(path: Path, picture: U8) -> None:
    with disk_errors(path):
        write_picture(path, picture)


def places_px(geometry: Geometry, presses: Sequence[KnownPress]) -> list[list[float]]:
    """Column and row of each stated place on the undeformed skin."""
    stated = np.array(
        [(one.x_mm, one.y_mm) for one in presses if one.x_mm is not None], np.float64
    ).reshape(-1, 2)
    z_mm = [skin_z_mm(geometry.skin_radius_mm, x, y) for x, y in stated.tolist()]
    found: list[list[float]] = project(geometry, np.column_stack((stated, z_mm))).tolist()
    return found


def _presses(
    args: argparse.Namespace, skin_radius_mm: float
) -> tuple[Sequence[KnownPress], tuple[str, ...]]:
    """Return the presses of the table, with depths for travels if so asked,
    and remarks on the table.
    """
    indenters = read_indenters(args.indenters) if args.indenters else {}
    presses, notes = read_presses(args.presses, indenters)
    if not presses:
        raise ConfigError(f"{args.presses}: found no press, expected at least one")
    if args.depth_from_touch:
        presses = [from_travel(press, skin_radius_mm) for press in presses]
        why = "after that travel its lowest point is still above the skin at (x, y); left out"
        notes += tuple(f"{press.name}: {why}" for press in presses if press.depth_mm <= 0)
        presses = [press for press in presses if not press.depth_mm <= 0]
    return presses, notes


def _rezero(args: argparse.Namespace) -> int:
    args.reference = images_in(args.reference)
    old, inputs = loading.load(args.rezero), calibration_file.inputs_in(args.rezero)
    images = _read_references(args.reference)
    if args.rest:
        check_rest(args.rest)
    try:
        names = list(map(str, args.reference))
        renewed = rezero(old, images, names, allow_loaded=args.allow_loaded_reference)
        # Keep even networks that cannot run: `doctor` then suggests a new fit.
        renewed = replace(renewed, fitted=calibration_file.fitted_in(args.rezero))
    except ConfigError as error:
        # The references alone give no hint at which calibration they were held against.
        raise ConfigError(f"{args.rezero}: {error}") from None
    disc = old.geometry.disc
    found = camera_drift.drift(
        camera_drift.look(old.reference_grey, disc, old.pitch_px), renewed.reference_grey
    )
    changes = (camera_drift.shift_reason(found, disc), found.light_reason)
    warnings = [f"{change} since {args.rezero}" for change in changes if change]
    digits_of = {"moved_px": 2, "light": 3, "contrast": 3}
    changed = {name: round(getattr(found, name), digits) for name, digits in digits_of.items()}
    more: dict[str, Any] = {**changed}
    rest = rest_of(args, renewed, images) if args.rest else None
    if rest:
        renewed = replace(renewed, rest=rest.limits)
        warnings += rest_warnings(rest)
        more |= rest_report(rest)
    # A file that holds no inputs can still be re-zeroed, but not made again by a later version.
    stored = calibration_file.save(args.out, renewed, inputs and with_new_reference(inputs, images))
    _print(args, stored, warnings, more)
    for line in rest_lines(rest, renewed) if rest and not args.json else ():
        print(line)
    return 0


def _read_references(paths: Sequence[Path]) -> list[U8]:
    try:
        references = [read_image(path) for path in paths]
    except DecodeError as error:
        raise ConfigError(f"--reference: {error}") from None
    # Here, and not where they are averaged: the message can name the file.
    first = size_text(references[0])
    for path, image in zip(paths, references, strict=True):
        if size_text(image) != first:
            expected = f"expected {first} px as in the first reference"
            raise ConfigError(f"--reference: {path}: found {size_text(image)} px, {expected}")
    return references


def _print(
    args: argparse.Namespace, stored: Calibration, warnings: Sequence[str], more: dict[str, Any]
) -> None:
    disc, geometry = stored.geometry.disc, stored.geometry
    figures = {
        "row_c": disc.row_c,
        "col_c": disc.col_c,
        "radius_px": disc.radius_px,
        "mm_per_px": geometry.mm_per_px,
    }
    figures |= {"f_px": geometry.f_px, "pitch_px": stored.pitch_px, "noise_grey": stored.noise_grey}
    figures |= {"alpha": stored.alpha, **calibration_file.fit_figures(stored.fit)}
    report: dict[str, Any] = {
        "crc32": f"{stored.crc32:08x}",
        **{key: round(figures[key], 6) for key in figures},
    }
    if args.json:
        print(json.dumps(report | more | {"warnings": list(warnings)}, indent=2))
        return
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"{args.out}: calibration {report.pop('crc32')}")
    for key, value in (
        report | {key: value for key, value in more.items() if isinstance(value, float)}
    ).items():
        print(f"  {key}: {value:.4g}" if isinstance(value, float) else f"  {key}: {value}")


def _report(made: _Made) -> dict[str, Any]:
    """What ``--json`` prints beyond the calibration's own figures."""
    quality = made.result.quality
    report: dict[str, Any] = {
        "verdict": quality.grade,
        "verdict_line": sentence(quality.line, WITH_OPTIONS),
        "to_do": [sentence(advice, WITH_OPTIONS) for advice in quality.advice],
    }
    report |= fit_report(made.fitted) if made.fitted else {}
    report |= touch_report(made.touch) if made.touch else {}
    return report | (rest_report(made.rest) if made.rest else {})


def _print_lines(made: _Made) -> None:
    """Print what was learnt, how good the calibration is, and what would make it better."""
    quality, fitted, fit = made.result.quality, made.fitted, made.calibration.fit
    for one in made.touch:
        print(*report_lines(one), sep="\n")
    if made.rest:
        print(*rest_lines(made.rest, made.calibration, made.result.presses), sep="\n")
    print(f"{'as shipped, ' if fitted else ''}{sentence(quality.line, WITH_OPTIONS)}")
    if used := fit and fit.profiles.get(DEFAULT):
        errors = f"{used.depth_mae_mm:.2f} mm on average, {used.depth_worst_mm:.2f} mm at worst"
        whose = f"the profile of `run`, its dashboard and `reconstruct` by default: {errors}"
        # "At worst" is of these presses alone: the next one is compared with nothing yet.
        print(f"  with {DEFAULT}, {whose} of these {used.presses}; others may be further off")
    if fitted:
        # Without networks, these lines are why the command fails.
        stream = sys.stdout if fitted.networks else sys.stderr
        for line in (*fitted.found, *(report.line for report in fitted.networks)):
            print(line, file=stream)
    to_do = (sentence(advice, WITH_OPTIONS) for advice in quality.advice)
    for advice in (*(fitted.advice if fitted else ()), *to_do):
        print(f"  to do: {advice}")
