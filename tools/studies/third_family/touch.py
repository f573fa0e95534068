"""Judge the touch model on the third family: it learns from plates, and is judged on other plates and new objects.

::

    nice ENGINE/bin/python -m tools.studies.third_family.solve --sensors 0 --touch --states STATES
    .venv/bin/python -m tools.studies.third_family.touch --states STATES

The first command needs MuJoCo (requirements.txt) and is slow; existing files in STATES stay as they are. Both states of
each path give a frame: pressed, then dragged and turned. `LABELS` frames of plates are labelled. The other plates, a
ball and a bar judge the model; an answer is "right" if its error is at most twice the mean error on the other plates.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from tacshade_edge.core.touch.answer import touch_by_model
from tacshade_edge.core.touch.learning import learn
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.studies.evaluate.sensors import SCENE_NOISE
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F32, F64
from tools.studies.third_family.domes import (
    FIRST_SEED,
    Dome,
    Kept,
    Way,
    deepest_mm,
    deformed,
    drawn,
    plate_depth_mm,
    renderer,
)
from tools.studies.third_family.evaluate import calibrated
from tools.studies.touch import SETS, Taker

NAMES, SHOWN = tuple(SETS["plates"].columns.values()), SETS["plates"].shown

RANGE, SENSOR = "working", 0
COUNTS = {"plate": 75, "ball": 10, "bar": 10}
LABELS = 100


def ways(dome: Dome) -> list[tuple[Way, float]]:
    """Draw paths of plates (tilted), balls and bars, each with its travel along the object's normal in mm."""
    rng = np.random.default_rng((FIRST_SEED[RANGE], 43))
    scale = dome.radius_mm / 20
    deepest = deepest_mm(dome)
    made = []
    for name, count in COUNTS.items():
        for _ in range(count):
            pressed = float(rng.uniform(0.5, 0.6 * deepest)) * scale
            tilt, lean, drag, along = (float(v) for v in rng.uniform((0, 0, 0, 0), (15, 2 * math.pi, 2.5, 2 * math.pi)))
            twist, turn = (float(v) for v in rng.uniform((-8, 0), (8, 360)))
            lean_deg = (tilt * math.cos(lean), tilt * math.sin(lean)) if name == "plate" else (0.0, 0.0)
            depth = plate_depth_mm(pressed, dome.radius_mm, scale, *lean_deg) if name == "plate" else pressed
            press = Press(
                OBJECTS[name](), 0.0, 0.0, depth, turn, scale, *lean_deg,
                drag * scale * math.cos(along), drag * scale * math.sin(along), twist,
            )  # fmt: skip
            made.append((Way(name, press), pressed))
    return made


def file_of(folder: Path, way: int) -> Path:
    """The file of a path's states."""
    return folder / f"touch-{RANGE}-{SENSOR}-{way}.npz"


def label(way: Way, pressed_mm: float, dragged: bool) -> tuple[float, ...]:
    """Return the label that a robot knows, in the order of `NAMES`."""
    press = way.press
    moved = (press.drag_x_mm, press.drag_y_mm, press.twist_deg) if dragged else (0.0, 0.0, 0.0)
    return (pressed_mm, press.tilt_x_deg, press.tilt_y_deg, *moved)


def seen(folder: Path, profile: str) -> tuple[list[str], F32, F32, F64, F64]:
    """Return object, features, imprint, label, and the touch without labels, of every frame in contact."""
    model, dome = drawn(RANGE, SENSOR)
    draws = renderer(model, FIRST_SEED[RANGE] + SENSOR)
    taker = Taker(calibrated(RANGE, SENSOR), profile)
    objects, labels, plain = [], [], []
    for k, (way, pressed_mm) in enumerate(ways(dome)):
        kept = Kept.read(file_of(folder, k))
        for dragged, at_mm in enumerate((kept.pressed_mm, kept.dragged_mm)):
            skin = deformed(dome.radius_mm, kept.rest_mm, at_mm)
            result = taker.take(draws.expose(draws.draw(skin), SCENE_NOISE + 2 * k + dragged))
            if result is not None and result.touch is not None:
                plain.append([result.touch.values[name] for name in NAMES])
                objects.append(way.object_name)
                labels.append(label(way, pressed_mm, bool(dragged)))
    features, imprints = np.stack(taker.features), np.stack(taker.imprints)
    return objects, features, imprints, np.array(labels), np.array(plain, float)


def report(folder: Path) -> None:
    """Learn, judge, and print the table."""
    lines = []
    for profile in ("balanced", "accurate"):
        objects, features, imprints, labels, plain = seen(folder, profile)
        plates = [k for k, name in enumerate(objects) if name == "plate"]
        order = np.random.default_rng(1).permutation(len(plates) // 2)
        shuffled = [plates[2 * way + end] for way in order for end in (0, 1)]  # a path's states stay together
        taught = shuffled[:LABELS]
        groups = np.arange(len(taught)) // 2
        learnt = learn(features[taught], imprints[taught], NAMES, labels[taught], groups, "study")
        assert learnt.model is not None
        usual = np.full(len(NAMES), math.nan)
        for name in COUNTS:
            judged = shuffled[LABELS:] if name == "plate" else [k for k, one in enumerate(objects) if one == name]
            touches = [touch_by_model(learnt.model, features[k], imprints[k]) for k in judged]
            found = np.array([[touch.values.get(q) for q in NAMES] for touch in touches], float)
            off = np.abs(found - labels[judged])
            if name == "plate":
                usual = np.array([np.nanmean(one) if np.isfinite(one).any() else math.nan for one in off.T])
            right = (off <= 2 * np.maximum(usual, 1e-9)) | np.isnan(off)
            cells = [
                f"{np.nanmean(off[:, list(columns)]):.2f}" if np.isfinite(off[:, list(columns)]).any() else "-"
                for columns in SHOWN.values()
            ]
            answered = np.isfinite(found[:, 0]).sum()
            lines.append((profile, name, str(len(judged)), str(answered), *cells, f"{100 * right[:, :5].mean():.0f} %"))
        off = np.abs(plain - labels)[plates]
        cells = [f"{np.nanmean(off[:, list(columns)]):.2f}" for columns in SHOWN.values()]
        lines.append((profile, "plate, without labels", str(len(plates)), str(len(plates)), *cells, ""))
        deviations = np.sqrt(np.nanmean(off**2, axis=0))
        deviation = dict(zip(NAMES, deviations.round(2).tolist(), strict=True))
        print(f"{profile}: standard deviations without labels: {deviation}")
    columns = ("profile", "object", "frames", "answered", *SHOWN, "right or no answer")
    print(markdown(columns, lines))


def main(arguments: list[str] | None = None) -> int:
    """Judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=Path, required=True)
    options = parser.parse_args(arguments)
    if not all(file_of(options.states, k).exists() for k in range(sum(COUNTS.values()))):
        print(f"{options.states}: not every way is solved: run solve.py --touch first", file=sys.stderr)
        return 1
    report(options.states)
    return 0


if __name__ == "__main__":
    sys.exit(main())
