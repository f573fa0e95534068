#!/usr/bin/env python3
"""The touch model on a robot's labelled frames: errors by number of labels, beside networks'.

::

    git clone https://github.com/dexterousrobot/tactile_data_shear out/real/tactile_data_shear
    git clone https://github.com/robot-dexterity/tactile-manibot out/real/tactile-manibot
    .venv/bin/python -m tools.studies.touch plates out/real/tactile_data_shear
    .venv/bin/python -m tools.studies.touch force out/real/tactile-manibot --out FOLDER

`plates` is `cr_tactip` of the first set, which has no licence, `force` one sensor of the second
(GPL), with measured forces: both stay outside the tree. It learns from one run of the robot and
judges another, of which every frame counts: if the model has no answer, the labels' mean is the
guess. `--out` draws the first frames of 400 labels.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.inference.network import load_network
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.sensor.touch.learning import learn
from tacshade_edge.sensor.touch.touch_answer import NO_IMPRINT, imprint_of, touch_by_model
from tacshade_edge.types import F32, F64, U8, Bool, Calibration, Frame, Need, Reconstruction
from tools.studies.real_frames import forced
from tools.studies.real_sets import SENSOR, SENSORS, rows_of

_DRAWN = {"depth_mm": "depth, mm", "force_z_n": "Fz, N", "force_x_n": "Fx, N"}
_POSE = {"pose_z": "depth_mm", "pose_Rx": "tilt_x_deg", "pose_Ry": "tilt_y_deg"}
_DRAG = {"shear_x": "shear_x_mm", "shear_y": "shear_y_mm", "shear_Rz": "twist_deg"}


@dataclass(frozen=True, slots=True)
class RobotSet:
    """Two runs of a robot: table, folder of pictures, labels by column, what is shown of them,
    and published errors.
    """

    folder: str
    runs: tuple[str, str]
    table: str
    pictures: str
    columns: Mapping[str, str]
    shown: Mapping[str, tuple[int, ...]]
    published: tuple[str, ...]
    sensor: StatedSensor = SENSOR


SETS = {
    "plates": RobotSet(
        "data/cr_tactip/surface_3d",
        ("train_data", "val_data"),
        "targets_images.csv",
        "processed_images",
        _POSE | _DRAG,
        {"depth mm": (0,), "tilt °": (1, 2), "shear mm": (3, 4), "twist °": (5,)},
        ("published networks", "4002", "0.106", "0.32", "0.78", "1.48", "", "", ""),
    ),
    "force": RobotSet(
        "tactile_data/ur5_tacpad_1/surface_zRxy_shear",
        ("train", "val"),
        "targets.csv",
        "sensor_images",
        _POSE | _DRAG | {"Fx": "force_x_n", "Fy": "force_y_n", "Fz": "force_z_n"},
        {
            "depth mm": (0,),
            "tilt °": (1, 2),
            "shear mm": (3, 4),
            "twist °": (5,),
            "Fx, Fy N": (6, 7),
            "Fz N": (8,),
        },
        ("published network", "6425", "0.111", "1.04", "", "", "", "", "", "", ""),
        SENSORS["tilted"],
    ),
}
LABELS = (6400, 1600, 400, 100)
DRAWN_LABELS, DRAWN_FRAMES = 400, 80


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """All frames of both runs: features, imprints and changed part of the usable ones, labels, and
    which are of the second run. A model without a lower one has the gate `gate_part`.
    """

    features: F32
    imprints: F32
    changed_parts: F64
    labels: F64
    usable: Bool
    second: Bool
    gate_part: float


class Taker:
    """A profile that takes from each frame what a touch model learns from."""

    def __init__(self, calibration: Calibration, profile: str) -> None:
        chosen = PROFILES[profile]
        assert chosen.network is not None
        self.features: list[F32] = []
        self.imprints: list[F32] = []
        self.changed_parts: list[float] = []
        self.made = Reconstructor(
            calibration, chosen, load_network(chosen.network), touch=self.features.append
        )

    def take(self, image: U8) -> Reconstruction | None:
        """The frame's result; None if it is not usable."""
        before = len(self.features)
        found = self.made.step(Frame(0, 0, 0, image), need=Need.TOUCH)
        if found is None or len(self.features) == before:
            return None
        self.changed_parts.append(self.made.changed_part)
        self.imprints.append(
            imprint_of(found.objects, found.volume_mm3) if found.contact else NO_IMPRINT
        )
        return found


def seen(robot: RobotSet, clone: Path, profile: str) -> Frames:
    """Run the networks over every frame once."""
    pictures, labels, second = [], [], []
    for run in robot.runs:
        for row in rows_of(clone / robot.folder / run / robot.table):
            pictures.append(clone / robot.folder / run / robot.pictures / row["sensor_image"])
            labels.append([float(row[name]) for name in robot.columns])
            second.append(run == robot.runs[1])
    known, later = np.array(labels), np.array(second)
    taker = Taker(
        forced(robot.sensor, [pictures[int(np.where(later, known[:, 0], np.inf).argmin())]]),
        profile,
    )
    usable = np.array([taker.take(read_image(path)) is not None for path in pictures])
    features, shown = (
        np.zeros((len(pictures), len(one[0])), np.float32)
        for one in (taker.features, taker.imprints)
    )
    features[usable], shown[usable] = taker.features, taker.imprints
    changed_parts = np.zeros(len(pictures))
    changed_parts[usable] = taker.changed_parts
    return Frames(features, shown, changed_parts, known, usable, later, taker.made.gate_part)


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Mean absolute errors, what 90 % intervals hold, part without an answer, and CPU seconds of
    learning; the judged frames' labels, answers and half intervals, NaN without an answer.
    """

    errors: F64
    holds: F64
    unanswered: float
    learning_s: float
    labels: F64
    answers: F64
    half_intervals: F64


def scored(frames: Frames, names: Sequence[str], count: int, seed: int) -> Score:
    """Learn from `count` frames of the first run and judge the second."""
    random = np.random.default_rng(seed)
    taught, judged = (
        random.permutation(np.flatnonzero(~frames.second))[:count],
        np.flatnonzero(frames.second),
    )
    taught = taught[frames.usable[taught]]
    began_s = time.process_time()
    table = frames.features[taught], frames.imprints[taught], frames.changed_parts[taught]
    learnt = learn(
        *table, names, frames.labels[taught], np.arange(len(taught), dtype=np.int64), "study"
    )
    learning_s = time.process_time() - began_s
    labels, model = frames.labels[judged], learnt.model
    answers, half = np.full(labels.shape, np.nan), np.full(labels.shape, np.nan)
    for k, at in enumerate(judged):
        if not frames.usable[at] or model is None:
            continue
        if frames.changed_parts[at] < min(model.gate_part, frames.gate_part):
            continue
        imprint = frames.imprints[at] if np.isfinite(frames.imprints[at, 0]) else None
        touch = touch_by_model(model, frames.features[at], imprint)
        for q, name in enumerate(names):
            value, sigma = touch.values.get(name), touch.sigma.get(name)
            if value is not None and sigma is not None:
                answers[k, q], half[k, q] = value, 1.645 * sigma
    known = np.isfinite(answers)
    errors = np.abs(labels - np.where(known, answers, frames.labels[taught].mean(axis=0)))
    held = np.where(known, errors <= half, np.nan)
    holds = np.array([np.nanmean(one) if np.isfinite(one).any() else np.nan for one in held.T])
    return Score(
        errors.mean(axis=0), holds, float(1 - known[:, 0].mean()), learning_s, labels, answers, half
    )


def draw(score: Score, names: Sequence[str], file: Path) -> None:
    """Draw what was measured, and answered with its 90 % intervals,
    of the first judged frames in their order.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(3, 1, figsize=(10, 6.5), sharex=True, layout="constrained")
    at = np.arange(DRAWN_FRAMES)
    for axis, (name, words) in zip(axes, _DRAWN.items(), strict=True):
        q = list(names).index(name)
        answers, half = score.answers[: len(at), q], score.half_intervals[: len(at), q]
        axis.errorbar(
            at, answers, half, fmt="none", ecolor="#8ab6e8", elinewidth=4, label="90 % interval"
        )
        axis.plot(at, answers, "o", color="#1f5fa8", markersize=4, label="touch model")
        axis.plot(
            at,
            score.labels[: len(at), q],
            "k_",
            markersize=9,
            markeredgewidth=1.6,
            label="robot, force sensor",
        )
        axis.set_ylabel(words)
        axis.grid(alpha=0.3)
    axes[0].legend(ncols=3, loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    axes[-1].set_xlabel("frame, in the order of the second run")
    figure.savefig(file, dpi=110)


def report(
    robot: RobotSet, clone: Path, profiles: Sequence[str], counts: Sequence[int], out: Path | None
) -> None:
    """Measure, print."""
    lines, names = [robot.published], tuple(robot.columns.values())
    for profile in profiles:
        frames = seen(robot, clone, profile)
        left = int((~frames.usable).sum())
        print(f"{profile}: {left} of {len(frames.usable)} frames are not usable", file=sys.stderr)
        for count in counts:
            scores = [scored(frames, names, count, seed) for seed in range(1 if count > 400 else 2)]
            if out and count == DRAWN_LABELS:
                draw(scores[0], names, out / "touch.png")
            errors = np.mean([one.errors for one in scores], axis=0)
            holds = np.mean([one.holds for one in scores], axis=0)
            lines.append(
                (
                    profile,
                    str(count),
                    *(f"{errors[list(columns)].mean():.3f}" for columns in robot.shown.values()),
                    f"{np.nanmin(holds):.2f} to {np.nanmax(holds):.2f}",
                    f"{100 * np.mean([one.unanswered for one in scores]):.1f} %",
                    f"{np.mean([one.learning_s for one in scores]):.1f}",
                )
            )
    columns = ("", "labels", *robot.shown, "90 % intervals hold", "no answer", "learning, CPU s")
    print(markdown(columns, lines))
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    print(
        "\n"
        f"Mean absolute errors. Peak memory of this study, all frames' features at once: {most} "
        "MB."
    )


def main(arguments: Iterable[str] | None = None) -> int:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=SETS)
    parser.add_argument("clone", type=Path)
    parser.add_argument(
        "--profile",
        nargs="+",
        choices=("fast", "balanced", "accurate"),
        default=("balanced", "accurate"),
    )
    parser.add_argument("--labels", nargs="+", type=int, default=LABELS)
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="draw touch.png")
    args = parser.parse_args(None if arguments is None else list(arguments))
    cv2.setNumThreads(1)
    try:
        report(SETS[args.set], args.clone, args.profile, args.labels, args.out)
    except (ConfigError, OSError) as error:
        print(f"touch.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
