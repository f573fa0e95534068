#!/usr/bin/env python3
"""What `calibrate` finds wrong, and what it finds wrong in good sets:
calibration-checks.md has the tables.

::

    .venv/bin/python -m tools.studies.calibration [--sensors 30] [--detect 30] [--first 8100]
        [--height 480]

Every sensor is drawn at random, with 5 references and 24 ball presses. A good set must pass without
a warning; then the study introduces one error at a time and counts the right warnings (or
refusals). An error in one press is introduced into each press in turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from support import bad_pictures
from tacshade_edge.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.calibration.observation import PressObservation, first_touch_mm
from tacshade_edge.calibration.presses.press_check import PressCheck
from tacshade_edge.calibration.presses.press_selection import outliers
from tacshade_edge.calibration.quality import GRADED_PROFILE
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.cli.shared.finding_options import WITH_OPTIONS
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.parallel import workers
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.sensor.frame_check import camera_drift
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import load_networks
from tacshade_edge.types import U8
from tools.studies import command

REFERENCES, PRESSES = 5, 24


@dataclass(frozen=True, slots=True)
class Set:
    """The references and presses that a user brings."""

    model: SensorModel
    simulated: SimulatedSensor
    sensor: StatedSensor
    references: list[U8]
    presses: list[KnownPress]

    @property
    def scale(self) -> float:
        """The factor on lengths on the nominal skin."""
        return skin_scale(self.model.geometry)

    def loaded(self, depth_mm: float, x_mm: float, y_mm: float, noise_seed: int) -> U8:
        """An image of the skin under a ball; mm on the nominal skin."""
        press = Press(
            ball(6.0 * self.scale), x_mm * self.scale, y_mm * self.scale, depth_mm * self.scale
        )
        return to_grey(self.simulated.frame((press,), noise_seed).image)

    def calibrate(
        self, references: list[U8] | None = None, presses: list[KnownPress] | None = None
    ) -> CalibrationResult:
        """Calibrate on this set, with other references or presses if given."""
        taken = self.presses if presses is None else presses
        return calibrate(
            self.sensor, references or self.references, taken, networks=load_networks()
        )


def good_set(seed: int, height_px: int) -> Set:
    """A good set of a random sensor."""
    model = random_model(seed, height_px, height_px * 4 // 3)
    simulated = SimulatedSensor(model)
    sensor = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
    )
    presses = [
        KnownPress(
            f"press {k}",
            to_grey(simulated.frame([p], 2000 + k).image),
            r,
            p.depth_mm,
            p.x_mm,
            p.y_mm,
        )
        for k, (p, r) in enumerate(ball_presses(model, PRESSES, seed))
    ]
    references = [to_grey(simulated.frame((), 1000 + k).image) for k in range(REFERENCES)]
    return Set(model, simulated, sensor, references, presses)


def answer(made: Callable[[], CalibrationResult]) -> str:
    """All warnings and advice for a set."""
    try:
        result = made()
    except ConfigError as error:
        return f"refused: {error}"
    said = (*result.warnings, result.quality.line, *result.quality.advice)
    return "\n".join(sentence(one, WITH_OPTIONS) for one in said)


def shifted(image: U8, px: float) -> U8:
    """Move an image to the right."""
    matrix = np.array([[1, 0, px], [0, 1, 0]], dtype=np.float64)
    size = (image.shape[1], image.shape[0])
    return np.asarray(
        cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def uneven(image: U8, part: float) -> U8:
    """Darken one side, as if one LED of a ring had aged."""
    ramp = 1 - part * np.linspace(0, 1, image.shape[1], dtype=np.float32)[None, :]
    return np.asarray(np.rint(image * ramp), np.uint8)


def wrong_presses(given: Set) -> Iterator[tuple[str, bool]]:
    """What is wrong with one press, and whether it is found; each press in turn."""
    unloaded, scale = given.calibrate(presses=[]).calibration, given.scale
    check, geometry = PressCheck(unloaded, load_networks()[GRADED_PROFILE]), unloaded.geometry
    looks = [check.look(press.image) for press in given.presses]
    grey = [
        check.observe(look.maps, press) for look, press in zip(looks, given.presses, strict=True)
    ]
    observed = [
        check.see(look, each, press)
        for look, each, press in zip(looks, grey, given.presses, strict=True)
    ]
    changes: dict[str, Callable[[KnownPress], KnownPress]] = {
        f"one depth {off:+.1f} mm off": lambda p, off=off: replace(
            p, depth_mm=p.depth_mm + off * scale
        )
        for off in (-1.5, 1.0, 1.5, 2.0, 2.5)
    }
    changes |= {
        f"one ball radius times {factor}": lambda p, factor=factor: replace(
            p, radius_mm=p.radius_mm * factor
        )
        for factor in (0.5, 0.67, 1.5, 2.0)
    }
    changes |= {
        f"one place {off} mm off": lambda p, off=off: replace(p, x_mm=(p.x_mm or 0.0) + off * scale)
        for off in (2, 3, 4, 5)
    }
    changes["x and y swapped at one press"] = lambda p: replace(p, x_mm=p.y_mm, y_mm=p.x_mm)
    for label, change in changes.items():
        for k, press in enumerate(given.presses):
            wrong = change(press)
            if wrong.depth_mm <= 0.2 * scale:
                continue
            stated = replace(
                grey[k],
                depth_mm=wrong.depth_mm,
                radius_mm=wrong.radius_mm,
                x_mm=wrong.x_mm,
                y_mm=wrong.y_mm,
            )
            found = outliers(
                [*observed[:k], check.see(looks[k], stated, wrong), *observed[k + 1 :]],
                geometry,
            )
            yield label, k in found


def other_rows(
    presses: list[KnownPress],
    rng: np.random.Generator,
    warnings: Callable[[list[KnownPress]], str],
) -> Iterator[tuple[str, str, str]]:
    """Images with the depths of other rows, with all their values, and with these but no places."""
    shuffled = rng.permutation([p.depth_mm for p in presses])
    yield (
        "all depths shuffled",
        "refused|poor",
        warnings([replace(p, depth_mm=float(d)) for p, d in zip(presses, shuffled, strict=True)]),
    )
    count = len(presses)
    numbers = np.arange(count)
    for label, wanted, order in (
        ("the row before", "the row before?", np.roll(numbers, 1)),
        ("the row after", "the row after?", np.roll(numbers, -1)),
        ("rows in the opposite order", "the opposite order?", numbers[::-1]),
        ("rows in another order", "another order?", rng.permutation(count)),
    ):
        values = [presses[k] for k in order]
        moved = [
            replace(other, image=one.image, name=one.name)
            for one, other in zip(presses, values, strict=True)
        ]
        yield f"values of {label}", wanted, warnings(moved)
        bare = [replace(one, x_mm=None, y_mm=None) for one in moved]
        yield f"values of {label}, without places", wanted, warnings(bare)


def wrong_sets(given: Set, rng: np.random.Generator) -> Iterator[tuple[str, str, str]]:
    """The error, the text that the answer must contain, and the answer."""
    presses, references, scale = given.presses, given.references, given.scale
    press = presses[int(rng.integers(4, len(presses) - 2))]
    name = f"{press.name}:"

    def warnings(made: list[KnownPress]) -> str:
        return answer(lambda: given.calibrate(presses=made))

    yield from other_rows(presses, rng, warnings)
    for unit, factor in (("cm", 0.1), ("inches", 1 / 25.4), ("m", 0.001)):
        yield (
            f"depths in {unit}",
            f"depths in {unit}?",
            warnings([replace(p, depth_mm=p.depth_mm * factor) for p in presses]),
        )
    touch = first_touch_mm(
        [PressObservation("", 1, 1, 1, 0, 0, p.radius_mm, 0, p.x_mm, p.y_mm) for p in presses],
        given.model.geometry,
    )
    travel = [
        replace(p, depth_mm=p.depth_mm - float(t)) for p, t in zip(presses, touch, strict=True)
    ]
    yield "depths are travel from first touch", "travel from first touch", warnings(travel)
    for off in (-0.5, 0.5, 1.0):
        made = [replace(p, depth_mm=p.depth_mm + off * scale) for p in presses]
        size, wanted = (
            ("small", "mm more: check where depth is zero")
            if off < 0
            else ("great", "mm less: check where depth is zero")
        )
        yield (
            f"all depths {abs(off)} mm too {size}",
            wanted,
            warnings([p for p in made if p.depth_mm > 0]),
        )
    yield (
        "x and y swapped",
        "swapped",
        warnings([replace(p, x_mm=p.y_mm, y_mm=p.x_mm) for p in presses]),
    )
    yield (
        "y with the other sign",
        "opposite sign",
        warnings([replace(p, y_mm=-(p.y_mm or 0)) for p in presses]),
    )
    near = sorted(presses, key=lambda p: (p.x_mm or 0) ** 2 + (p.y_mm or 0) ** 2)[:8]
    yield "8 presses in the middle", "close together", warnings(near)
    yield (
        "half the disc",
        "no press lies|close together",
        warnings([p for p in presses if (p.x_mm or 0) > -1]),
    )
    alike = sorted(presses, key=lambda p: p.depth_mm)[-10:]
    yield "10 presses of like depth", "mm deep: add some", warnings(alike)
    alike = sorted(presses, key=lambda p: p.radius_mm)[8:16]
    yield "8 presses of like radius", "all presses use balls", warnings(alike)
    for px in (0.5, 1.0, 2.0, 6.0):
        yield (
            f"camera {px} px away at one press",
            f"{name} the image moved",
            warnings(
                [replace(p, image=shifted(p.image, px)) if p is press else p for p in presses]
            ),
        )
    for px in (1.0, 2.0, 6.0):
        views = [references[0], *(shifted(image, px) for image in references[1:])]
        yield (
            f"camera {px} px away after the first reference",
            "moved",
            answer(lambda views=views: given.calibrate(views, [])),
        )
    for label, change in {
        "light x 0.75": lambda image: camera_faults.gain(image, 0.75),
        "light x 0.9 (compensated)": lambda image: camera_faults.gain(image, 0.9),
        "one side 40 % darker": lambda image: uneven(image, 0.4),
        "blurred by 1.5 px": lambda image: bad_pictures.defocus(image, 1.5),
    }.items():
        made = [replace(p, image=change(p.image)) if p is press else p for p in presses]
        yield f"{label} at one press", f"{name}", warnings(made)
    for depth in (1.0, 2.0):
        image = given.loaded(depth, 3, 2, 5)
        yield (
            f"one reference of 5 under {depth} mm",
            "pressed|load",
            answer(lambda image=image: given.calibrate([*references[1:], image], [])),
        )
    for depth in (1.0, 2.0, 3.0):
        for place, x_mm in (("in the middle", 0.0), ("5 mm beside", 5.0)):
            images = [given.loaded(depth, x_mm, 0, k) for k in range(3)]
            yield (
                f"all references under {depth} mm {place}",
                "seems pressed",
                answer(lambda images=images: given.calibrate(images, [])),
            )


def rezeros(given: Set, result: CalibrationResult) -> Iterator[tuple[str, str, str]]:
    """New references that must be taken, and some that must not."""

    def said(images: list[U8]) -> str:
        try:
            rezero(result.calibration, images)
        except ConfigError as error:
            return f"refused: {error}"
        return "taken"

    free = [to_grey(given.simulated.frame((), 3000 + k).image) for k in range(5)]
    yield "rezero: untouched", "taken", said(free)
    yield "rezero: light x 0.7", "taken", said([camera_faults.gain(image, 0.7) for image in free])
    yield "rezero: 2 px away", "taken", said([shifted(image, 2) for image in free])
    yield "rezero: 6 px away", "refused", said([shifted(image, 6) for image in free])
    yield "rezero: light x 0.4", "refused", said([camera_faults.gain(image, 0.4) for image in free])
    yield (
        "rezero: blurred by 3 px",
        "refused",
        said([bad_pictures.defocus(image, 3) for image in free]),
    )
    for depth in (1.0, 2.0, 3.0):
        yield f"rezero: under {depth} mm", "refused", said([given.loaded(depth, 3, 2, 5)] * 3)


@dataclass(frozen=True, slots=True)
class Measured:
    """One sensor's figures: false alarms, what was found, (label, depth, agreement, grade),
    drift of good presses.
    """

    alarms: list[str]
    found: list[tuple[str, bool]]
    quality: list[tuple[str, float, float, str]]
    drifts: list[camera_drift.Drift]


def measure(task: tuple[int, bool, int]) -> Measured:
    """One sensor of a seed and image height: as a good set, and, with `detect`,
    with everything that can be wrong.
    """
    seed, detect, height_px = task
    rng = np.random.default_rng(seed)
    given = good_set(seed, height_px)
    try:
        result = given.calibrate()
    except ConfigError as error:
        return Measured([f"sensor {seed}: refused: {error}"], [], [], [])
    calibration = result.calibration
    look = camera_drift.look(
        calibration.reference_grey, calibration.geometry.disc, calibration.pitch_px
    )
    quality = []
    for sigma in (0.0, 0.3, 0.6):
        label = f"depths stated {sigma} mm off (standard deviation)" if sigma else "good sets"
        jitter = sigma * given.scale * rng.standard_normal(PRESSES)
        presses = [
            replace(p, depth_mm=max(p.depth_mm + e, 0.2))
            for p, e in zip(given.presses, jitter, strict=True)
        ]
        try:
            made = given.calibrate(presses=presses)
        except ConfigError:
            quality.append((label, np.nan, np.nan, "refused"))
            continue
        fit = made.calibration.fit
        depth_mm = (
            fit.profiles[GRADED_PROFILE].depth_mae_mm
            if fit and GRADED_PROFILE in fit.profiles
            else np.nan
        )
        agreement_mm = fit.agreement_mae_mm if fit else np.nan
        quality.append(
            (label, depth_mm / given.scale, agreement_mm / given.scale, made.quality.grade)
        )
    found = list(wrong_presses(given)) if detect else []
    found += [
        (label, any(part in said for part in wanted.split("|")))
        for label, wanted, said in (
            (*wrong_sets(given, rng), *rezeros(given, result)) if detect else ()
        )
    ]
    heard = (*result.warnings, *result.quality.advice)
    alarms = [f"sensor {seed}: {sentence(one, WITH_OPTIONS)}" for one in heard]
    drifts = [camera_drift.drift(look, press.image) for press in given.presses]
    return Measured(alarms, found, quality, drifts)


def report(measured: Sequence[Measured]) -> str:
    """The document's tables, in Markdown."""
    good = sum(bool(m.quality) for m in measured)
    alarms = [alarm for m in measured for alarm in m.alarms]
    lines = [
        (
            f"False alarms in {len(measured)} good sets ({good} calibrated, {good * PRESSES} "
            f"presses): {len(alarms)}"
        )
    ]
    lines += [f"- {alarm}" for alarm in alarms] + ["", "| what was wrong | said |", "|---|---|"]
    found: dict[str, list[bool]] = {}
    for label, hit in (pair for m in measured for pair in m.found):
        found.setdefault(label, []).append(hit)
    lines += [f"| {label} | {sum(hits)} of {len(hits)} |" for label, hits in found.items()]
    lines += [
        "",
        (
            "| presses | depth error mm: median, 90 %, worst | agreement_mae_mm likewise | good, "
            "fair, poor, refused |"
        ),
        "|---|---|---|---|",
    ]
    quality = [row for m in measured for row in m.quality]
    for label in dict.fromkeys(row[0] for row in quality):
        rows = [row for row in quality if row[0] == label]
        cells = [label]
        for column in (1, 2):
            quantiles = np.nanquantile([row[column] for row in rows], [0.5, 0.9, 1.0])
            cells.append(", ".join(f"{v:.2f}" for v in quantiles))
        grades = [
            sum(row[3] == grade for row in rows) for grade in ("good", "fair", "poor", "refused")
        ]
        cells.append(", ".join(map(str, grades)))
        lines.append(f"| {' | '.join(cells)} |")
    all_drifts = [d for m in measured for d in m.drifts]
    seen = [d for d in all_drifts if d.still_part > 0]
    lines += [
        "",
        (
            f"Drift of good presses: measured in {len(seen)} of {len(all_drifts)}; the most: shift "
            f"{max(d.shift_px for d in seen):.2f} px, with turn and zoom "
            f"{max(d.moved_px for d in seen):.2f} px, light {min(d.light for d in seen):.3f} to "
            f"{max(d.light for d in seen):.3f}, uneven {max(d.uneven for d in seen):.3f}, contrast "
            f"{min(d.contrast for d in seen):.2f}"
        ),
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description="What `calibrate` detects, and its false alarms.")
    parser.add_argument("--sensors", type=int, default=30)
    parser.add_argument(
        "--detect", type=int, default=30, help="so many of them are also made wrong (30)"
    )
    parser.add_argument("--first", type=int, default=8100, help="seed of the first sensor")
    parser.add_argument("--height", type=int, default=480, help="of the images, px")
    args = parser.parse_args()
    tasks = [(args.first + k, k < args.detect, args.height) for k in range(args.sensors)]
    with command.folder_for(parser, None), workers() as pool:
        print(report(list(pool.map(measure, tasks))))


if __name__ == "__main__":
    main()
