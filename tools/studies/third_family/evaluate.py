"""Judge the shipped networks on the third family, with a table of errors, shear,
intervals and refused frames.

::

    .venv/bin/python -m tools.studies.third_family.evaluate --range working --states FOLDER
        [--presses 40]

FOLDER contains the solved mechanics (solve.py), so MuJoCo is not needed. Every sensor is calibrated
on references and, with ``--presses``, on presses; `tools.studies.strangers` fits the networks to
them. ``--out`` writes a row for each frame and profile to third-family.csv; ``--pictures`` writes
PNG frames.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, undeformed
from tacshade_edge.lab.simulator.truth import Truth, shear_mm, skin_points
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, score
from tacshade_edge.lab.studies.evaluate.work import (
    REFERENCE_NOISE,
    REFERENCES,
    SCENE_NOISE,
    reconstructor,
)
from tacshade_edge.lab.studies.markdown import csv_text, grouped, summary
from tacshade_edge.sensor.depth.sigma import INTERVAL_90
from tacshade_edge.sensor.inference.network import load_networks
from tacshade_edge.types import U8, Calibration, Frame, Reconstruction
from tools.studies.third_family.domes import (
    FIRST_SEED,
    RANGES,
    Kept,
    Way,
    deformed,
    drawn,
    kept_file,
    known_presses,
    renderer,
    seen_truth,
    ways,
)

PROFILES = ("accurate", "balanced", "fast")
LEAST_TRUE_CELLS = 30
"""A frame with fewer pixels of true contact is not judged."""


@dataclass(frozen=True, slots=True, eq=False)
class Pictured:
    """A state as the camera sees it, and its truth."""

    label: Label
    dragged: bool
    press: Press
    skin: Skin
    truth: Truth
    image: U8


@dataclass(frozen=True, slots=True)
class Judged:
    """One frame, judged with one profile; each attribute is a column of third-family.csv,
    empty for NaN.
    """

    profile: str
    sensor: str
    object: str
    dragged: bool
    drag_mm: float
    true_depth_mm: float
    found_depth_mm: float
    refused: str  # why the frame was refused, or empty
    me_mm: float  # eqs. 13 and 14
    sd_pct: float
    shear_error_mm: (
        float  # median distance between found and true shear over the cells found in contact
    )
    cells: int  # found in contact, and those of them whose 90 % interval holds the true height
    covered: int


def pictured(range_name: str, sensor: int, way_count: int, folder: Path) -> Iterator[Pictured]:
    """Draw every stored state of a sensor."""
    model, dome = drawn(range_name, sensor)
    draws = renderer(model, FIRST_SEED[range_name] + sensor)
    for k, way in enumerate(ways(dome, FIRST_SEED[range_name] + sensor, way_count)):
        kept = Kept.read(kept_file(folder, range_name, sensor, "", k))
        ends = (way.pressed(dome.radius_mm), kept.pressed_mm), (way.press, kept.dragged_mm)
        for dragged, (press, at_mm) in enumerate(ends):
            skin = deformed(dome.radius_mm, kept.rest_mm, at_mm)
            truth = seen_truth(skin, (press,), model)
            image = draws.expose(draws.draw(skin), SCENE_NOISE + 2 * k + dragged)
            yield Pictured(
                _label(range_name, sensor, way, press), bool(dragged), press, skin, truth, image
            )


def calibrated(range_name: str, sensor: int, presses: Sequence[KnownPress] = ()) -> Calibration:
    """Calibrate a sensor on pictures of its untouched skin and presses. Raises ConfigError."""
    model, dome = drawn(range_name, sensor)
    draws = renderer(model, FIRST_SEED[range_name] + sensor)
    untouched = draws.draw(undeformed(dome.radius_mm))
    stated = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
    )
    references = [draws.expose(untouched, REFERENCE_NOISE + k) for k in range(REFERENCES)]
    return calibrate(stated, references, list(presses), networks=load_networks()).calibration


def judged(each: Pictured, model: SensorModel, result: Reconstruction) -> Judged:
    """Compare a reconstruction with the truth."""
    row = score(each.label, KnownTruth.of(each.truth), result)
    i, j = np.nonzero(result.height.contact)
    at = (
        origin + result.height.step_px * k.astype(float)
        for origin, k in ((result.height.row0, i), (result.height.col0, j))
    )
    points = skin_points(each.skin, model.geometry, *at)
    found = result.height.height_mm[result.height.contact]
    off = np.abs(found - (each.skin.radius_mm - np.linalg.norm(points, axis=1)))
    sheared = math.nan
    if result.shear_mm is not None and len(points):
        wrong = result.shear_mm[result.height.contact] - shear_mm(each.skin, points, model.friction)
        sheared = float(np.median(np.linalg.norm(wrong, axis=1)))
    covered = (
        0
        if result.sigma_mm is None
        else off <= INTERVAL_90 * result.sigma_mm[result.height.contact]
    )
    return Judged(
        profile=result.profile,
        sensor=each.label.sensor,
        object=each.label.object,
        dragged=each.dragged,
        drag_mm=math.hypot(each.press.drag_x_mm, each.press.drag_y_mm),
        true_depth_mm=each.truth.depth_max_mm,
        found_depth_mm=result.depth_max_mm,
        refused="" if result.valid else row.degraded,
        me_mm=row.me_mm,
        sd_pct=row.sd_pct,
        shear_error_mm=sheared,
        cells=len(points),
        covered=int(np.count_nonzero(covered)),
    )


def _found(some: Sequence[Judged]) -> list[Judged]:
    return [row for row in some if not row.refused and row.cells]


def _depth_off_pct(row: Judged) -> float:
    return 100 * abs(row.found_depth_mm / row.true_depth_mm - 1)


def _covered_pct(some: Sequence[Judged]) -> float:
    return 100 * sum(row.covered for row in some) / max(sum(row.cells for row in some), 1)


FIGURES: dict[str, Callable[[Sequence[Judged]], str]] = {
    "frames": lambda some: str(len(some)),
    "refused": lambda some: str(sum(bool(row.refused) for row in some)),
    "missed": lambda some: str(sum(not row.refused and not row.cells for row in some)),
    "ME mm": lambda some: f"{np.mean([row.me_mm for row in _found(some)]):.3f}",
    "SD %": lambda some: f"{np.nanmean([row.sd_pct for row in some if not row.refused]):.1f}",
    "depth off %": lambda some: f"{np.median([_depth_off_pct(row) for row in _found(some)]):.0f}",
    "shear off mm": lambda some: (
        f"{np.nanmedian([row.shear_error_mm for row in _found(some)]):.2f}"
    ),
    "in the 90 % interval %": lambda some: f"{_covered_pct(_found(some)):.1f}",
}


def table(rows: Sequence[Judged]) -> str:
    """A line for each profile, pressed and dragged."""
    groups = grouped(
        sorted(rows, key=lambda row: (row.dragged, row.profile)),
        lambda row: (row.dragged, row.profile),
    )
    lines = [
        (("dragged" if dragged else "pressed", profile), some)
        for (dragged, profile), some in groups.items()
    ]
    return summary(("skin", "profile"), lines, FIGURES)


def main(arguments: list[str] | None = None) -> int:
    """Judge all sensors and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--range", choices=RANGES, default="working")
    parser.add_argument("--sensors", type=int, default=6)
    parser.add_argument("--ways", type=int, default=6)
    parser.add_argument("--states", type=Path, required=True, help="what solve.py wrote")
    parser.add_argument(
        "--presses", type=int, default=0, help="that each sensor is calibrated on (none)"
    )
    parser.add_argument("--out", type=Path)
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args(arguments)
    wanted = (("", options.ways), ("press", options.presses))
    own = (
        (sensor, what, k)
        for sensor in range(options.sensors)
        for what, count in wanted
        for k in range(count)
    )
    if missing := [
        path for at in own if not (path := kept_file(options.states, options.range, *at)).exists()
    ]:
        print(
            f"{missing[0]} is missing ({len(missing)} of these): solve them first with solve.py",
            file=sys.stderr,
        )
        return 1
    rows: list[Judged] = []
    for sensor in range(options.sensors):
        model, _ = drawn(options.range, sensor)
        try:
            presses = known_presses(options.range, sensor, options.presses, options.states)
            calibration = calibrated(options.range, sensor, presses)
        except ConfigError as error:
            print(f"sensor {sensor} cannot be calibrated: {error}", file=sys.stderr)
            continue
        made = [reconstructor(calibration, profile) for profile in PROFILES]
        for k, each in enumerate(pictured(options.range, sensor, options.ways, options.states)):
            if options.pictures:
                options.pictures.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(
                    str(options.pictures / f"{options.range}-{sensor}-{k:02d}.png"), each.image
                )
            if len(each.truth.points_mm) >= LEAST_TRUE_CELLS:
                rows += [
                    judged(each, model, solver.step(Frame(0, 0, 0, each.image))) for solver in made
                ]
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "third-family.csv").write_text(csv_text(Judged, rows), encoding="utf-8")
    print(table(rows))
    return 0


def _label(range_name: str, sensor: int, way: Way, press: Press) -> Label:
    return Label(
        f"third-{range_name}:{sensor}",
        way.object_name,
        "",
        press.depth_mm,
        press.x_mm,
        press.y_mm,
        press.rotation_deg,
    )


if __name__ == "__main__":
    sys.exit(main())
