"""Run both loops in real time at several speeds and added delays; compare them with the truth.

::

    .venv/bin/python -m tools.examples.servo.bench [--scene surface edge] [--speeds 5 10 20]
        [--delays 0 20 50 100]

Each run starts mosquitto, a daemon on 60 frames a second from the simulated sensor
(`tools.testbed.servo`), and a loop as a user starts it. The robot obeys after 20 ms plus the added
latency, and its velocity follows with a time constant of 30 ms. Before that, ``calibrate --labels``
learns the touch model from frames of a robot that presses a flat box.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from support.mqtt_rig import Broker
from tacshade_edge.lab.simulator.render import Renderer
from tacshade_edge.lab.simulator.skin import undeformed
from tacshade_edge.lab.studies.markdown import markdown
from tools.testbed.servo.skins import MODEL
from tools.testbed.servo.world import Scene, scene

_COLOURS = ("#3d6fb4", "#4a9c5d", "#e4572e", "#8a5fb0")
LABELS, REFERENCES = 400, 8
RANGES: Final = {
    "surface": {"depth_mm": (0.4, 3.0), "tilt_x_deg": (-12, 12), "tilt_y_deg": (-12, 12)},
    "edge": {"depth_mm": (0.5, 3.0), "y_mm": (-4, 4), "edge_deg": (-25, 25)},
}
ASKED: Final = {"depth_mm": 1.5}
OWN_DELAY_S, SETTLING_S, SECONDS = 0.02, 2.0, 12.0
_SENSOR = """\
skin_radius_mm: {model.skin_radius_mm}
camera_distance_mm: {model.camera_distance_mm}
visible_half_angle_deg: {model.visible_half_angle_deg}
polarity: bright
"""
_SETTINGS = """\
sensor_id: servo
profile: balanced
calibration: {calibration}
source: {{kind: rpicam, width_px: {model.image_width_px}, height_px: {model.image_height_px}, \
fps: 60}}
mqtt: {{host: 127.0.0.1, port: {port}}}
"""


@dataclass(frozen=True, slots=True)
class Run:
    """One run: root mean square and greatest error of each quantity after `SETTLING_S`,
    and how the loop ran.

    `labelled` distinguishes a model learnt from labels from height map and shear. `touches_s` and
    `age_ms` are the touches per second that the loop used, and their age then; `lost` is the share
    of frames that the simulated camera was too slow to draw.
    """

    scene: str
    labelled: bool
    speed_mm_s: float
    delay_ms: float
    error: Mapping[str, float]
    worst: Mapping[str, float]
    touches_s: float
    age_ms: float
    lost: float


def calibrate(folder: Path, name: str, place: Scene, *, labelled: bool) -> Path:
    """Draw references, and labelled frames if `labelled`, and run ``calibrate`` on them."""
    rng, draws = np.random.default_rng(5), Renderer(MODEL)
    images = folder / f"{name}{'' if labelled else '_alone'}"
    images.mkdir()
    (images / "SENSOR.yaml").write_text(_SENSOR.format(model=MODEL))
    free = draws.draw(undeformed(MODEL.skin_radius_mm))
    references = [images / f"reference_{k}.png" for k in range(REFERENCES)]
    for k, path in enumerate(references):
        cv2.imwrite(str(path), draws.expose(free, k)[..., 1])
    lines = [",".join(("image", *RANGES[name]))]
    for k in range(LABELS if labelled else 0):
        touch = {quantity: float(rng.uniform(*ends)) for quantity, ends in RANGES[name].items()}
        cv2.imwrite(
            str(images / f"{k}.png"), draws.expose(draws.draw(place.skin(touch)), 100 + k)[..., 1]
        )
        lines.append(",".join((f"{k}.png", *(f"{value:.4f}" for value in touch.values()))))
    (images / "LABELS.csv").write_text("\n".join(lines) + "\n")
    words: list[str | Path] = [
        "calibrate",
        "--sensor",
        images / "SENSOR.yaml",
        "--reference",
        *references,
    ]
    words += ["--labels", images / "LABELS.csv"] if labelled else []
    made = images / "calibration.npz"
    words += ["--out", made]
    done = subprocess.run(
        [sys.executable, "-m", "tacshade_edge", *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"calibrate: {done.stderr}")
    print(done.stdout, file=sys.stderr)
    return made


@contextmanager
def sensor(
    folder: Path, calibration: Path, name: str, delay_s: float, log: Path
) -> Iterator[tuple[int, int]]:
    """Run a broker and a daemon whose camera moves with the robot;
    yield the ports of broker and robot.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        robot = int(probe.getsockname()[1])
    scenario = {
        "scene": name,
        "delay_s": delay_s,
        "port": robot,
        "kept": str(folder),
        "log": str(log),
    }
    program = folder / "rpicam-vid"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m tools.testbed.servo.rpicam_vid "$@"\n')
    program.chmod(0o755)
    path = f"{folder}:{os.environ['PATH']}"
    with Broker(folder) as broker:
        config = folder / "config.yaml"
        config.write_text(_SETTINGS.format(calibration=calibration, model=MODEL, port=broker.port))
        words = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
        daemon = subprocess.Popen(
            words,
            env=os.environ | {"SERVO": json.dumps(scenario), "PATH": path},
            stderr=subprocess.DEVNULL,
        )
        try:
            end_s = time.monotonic() + 60
            while not (log.exists() and log.stat().st_size > 2000):
                if daemon.poll() is not None or time.monotonic() > end_s:
                    raise SystemExit("found no frame of the daemon's camera within 60 s")
                threading.Event().wait(0.1)
            yield broker.port, robot
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait()


def once(
    folder: Path,
    calibration: Path,
    name: str,
    speed_mm_s: float,
    delay_ms: float,
    *,
    labelled: bool,
) -> Run:
    """Run one loop and measure its errors."""
    log = folder / "truth.csv"
    log.unlink(missing_ok=True)
    with sensor(folder, calibration, name, OWN_DELAY_S + delay_ms / 1e3, log) as (port, robot):
        words = [
            sys.executable,
            "-m",
            f"tools.examples.servo.follow_{name}",
            f"127.0.0.1:{port}",
            "servo",
        ]
        words += [
            "--robot",
            f"127.0.0.1:{robot}",
            "--speed-mm-s",
            str(speed_mm_s),
            "--seconds",
            str(SECONDS),
        ]
        words += ["--depth-mm", str(ASKED["depth_mm"])]
        done = subprocess.run(
            words, capture_output=True, text=True, check=False, timeout=SECONDS + 60
        )
    found = re.search(r"touches, ([\d.]+) a second, ([\d.]+) ms", done.stdout)
    if not found:
        raise SystemExit(f"follow_{name}: exit code {done.returncode}: {done.stdout}{done.stderr}")
    with log.open() as stream:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
    x_mm = np.array([row["x_mm"] for row in rows])
    began = int(np.argmax(np.abs(x_mm - x_mm[0]) > 0.01))
    t_s = np.array([row["t_ns"] for row in rows]) / 1e9
    counts = (t_s > t_s[began] + SETTLING_S) & (t_s < t_s[began] + SECONDS - 0.5)
    off = {
        quantity: np.array([row[quantity] for row in rows])[counts] - ASKED.get(quantity, 0.0)
        for quantity in RANGES[name]
    }
    lost = sum(row["lost"] for row in rows) / (len(rows) + sum(row["lost"] for row in rows))
    return Run(
        scene=name,
        labelled=labelled,
        speed_mm_s=speed_mm_s,
        delay_ms=delay_ms,
        error={quantity: math.sqrt(float(np.mean(each**2))) for quantity, each in off.items()},
        worst={quantity: float(np.abs(each).max()) for quantity, each in off.items()},
        touches_s=float(found[1]),
        age_ms=float(found[2]),
        lost=lost,
    )


def draw(runs: list[Run]) -> bytes:
    """Draw a PNG: a row per scene, each quantity's error against added latency,
    a line per speed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(run.scene for run in runs))
    columns = max(len(run.error) for run in runs)
    figure = Figure(
        figsize=(4.2 * columns, 3.2 * len(scenes)), dpi=100, facecolor="white", layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(scenes), columns, squeeze=False)
    for row, name in zip(axes, scenes, strict=True):
        some = [run for run in runs if run.scene == name]
        for each, quantity in zip(row, some[0].error, strict=True):
            speeds = list(dict.fromkeys(run.speed_mm_s for run in some))
            for speed, labelled in dict.fromkeys((run.speed_mm_s, run.labelled) for run in some):
                key = (speed, labelled)
                line = [
                    (run.delay_ms, run.error[quantity])
                    for run in some
                    if (run.speed_mm_s, run.labelled) == key
                ]
                each.plot(
                    *zip(*line, strict=True),
                    color=_COLOURS[speeds.index(speed) % len(_COLOURS)],
                    marker="o",
                    linestyle="-" if labelled else ":",
                    label=f"{speed:g} mm/s{'' if labelled else ', without labels'}",
                )
            each.spines[["top", "right"]].set_visible(False)
            each.grid(color="#e6e6e6", linewidth=0.8)
            each.set_axisbelow(True)
            words, _, unit = quantity.rpartition("_")
            unit = {"deg": "°"}.get(unit, unit)
            each.set(
                title=f"follow_{name}: {words.replace('_', ' ')}", xlabel="added latency in ms"
            )
            each.set_ylabel(f"root mean square error in {unit}")
            each.set_ylim(0, 1.1 * max(run.error[quantity] for run in some))
    figure.legend(
        *axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False
    )
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def table(runs: list[Run]) -> str:
    """Write a table for each scene, with and without labels."""
    parts = []
    for name, labelled in dict.fromkeys((run.scene, run.labelled) for run in runs):
        some = [run for run in runs if (run.scene, run.labelled) == (name, labelled)]
        columns = (
            "speed, mm/s",
            "added, ms",
            *(quantity.replace("_", " ") for quantity in RANGES[name]),
        )
        lines = [
            (
                f"{run.speed_mm_s:g}",
                f"{run.delay_ms:g}",
                *(
                    f"{run.error[quantity]:.2f} ({run.worst[quantity]:.2f})"
                    for quantity in RANGES[name]
                ),
                f"{run.touches_s:.0f}",
                f"{run.age_ms:.0f}",
                f"{100 * run.lost:.1f} %",
            )
            for run in some
        ]
        text = markdown((*columns, "touches a second", "their age, ms", "frames not drawn"), lines)
        parts.append(f"## follow_{name}{'' if labelled else ', without labels'}\n\n{text}")
    return "\n\n".join(parts)


def main() -> int:
    """Calibrate, run the loops, and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scene", nargs="+", choices=tuple(RANGES), default=list(RANGES))
    parser.add_argument(
        "--speeds", nargs="+", type=float, default=[5.0, 10.0, 20.0], metavar="MM_S"
    )
    parser.add_argument(
        "--delays", nargs="+", type=float, default=[0.0, 20.0, 50.0, 100.0], metavar="MS"
    )
    parser.add_argument("--out", type=Path, help="a folder for servo.png")
    args = parser.parse_args()
    runs = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for each, labelled in [(name, True) for name in args.scene] + [("surface", False)] * (
            "surface" in args.scene
        ):
            calibration = calibrate(folder, each, scene(each, folder), labelled=labelled)
            for speed_mm_s in args.speeds if labelled else args.speeds[:2][-1:]:
                for delay_ms in args.delays:
                    runs.append(
                        once(folder, calibration, each, speed_mm_s, delay_ms, labelled=labelled)
                    )
                    print(runs[-1], file=sys.stderr, flush=True)
    print(table(runs))
    print(
        f"\nErrors are root mean squares (and the worst) over {SECONDS - SETTLING_S - 0.5:g} s, "
        f"from {SETTLING_S:g} s after the start, which is 0.5 mm too shallow."
    )
    if args.out:
        (args.out / "servo.png").write_bytes(draw(runs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
