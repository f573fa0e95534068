"""Makes what the tests in the guests are handed; their conftest runs this before the guests boot."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from support.handed_in import CAPTURED, IMAGES_A_PRESS, PAINTED, PRESSED, PROFILE
from tacshade_edge.cli import main
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.simulator.truth import SimulatedSensor
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import FREE, TOUCHED, enlarged, enlarged_calibration

PRESSES = {"ball": (-2.5, 0.0, 3.0), "cube": (2.5, 0.0, 3.0)}
IMAGES_FREE = 6


def make_painted() -> None:
    """The painted sensor: its free and its touched image."""
    calibration_file.save(PAINTED / "calibration.npz", enlarged_calibration())
    np.save(PAINTED / "images.npy", np.stack([enlarged(FREE)] * 10 + [enlarged(TOUCHED)] * 20))


def make_pressed() -> None:
    """A simulated sensor, calibrated by the command line on 20 ball presses; then a ball and a cube, pressed.

    Of each press the true depth, and that which the core finds in the very image.
    """
    with TemporaryDirectory() as folder:
        made = Path(folder)
        assert main(["simulate", "--calibration-set", str(made), "--presses", "20", "--seed", "3"]) == 0
        words = ["calibrate", "--sensor", made / "SENSOR.yaml", "--presses", made / "PRESSES.csv"]
        words += ["--out", PRESSED / "calibration.npz", "--reference", *sorted(made.glob("reference_*.png"))]
        assert main([str(word) for word in words]) == 0
    calibration = calibration_file.load(PRESSED / "calibration.npz")
    made_for = make_reconstructor(calibration, PROFILES[PROFILE])
    sensor = SimulatedSensor()
    images = [to_grey(sensor.frame((), noise_seed=60).image)] * IMAGES_FREE
    truth = {}
    for k, (name, place) in enumerate(PRESSES.items()):
        frame = sensor.frame([Press(OBJECTS[name](), *place)], noise_seed=70 + k)
        images += [to_grey(frame.image)] * IMAGES_A_PRESS + images[:IMAGES_FREE]
        found = made_for.step(Frame(0, 0, 0, to_grey(frame.image)))
        truth[name] = {
            "x_mm": place[0],
            "depth_mm": float(frame.skin.height_mm.max()),
            "found_mm": float(np.nanmax(found.height.height_mm)),
        }
    np.save(PRESSED / "images.npy", np.stack(images))
    (PRESSED / "facts.json").write_text(json.dumps(truth))


def make_captured() -> None:
    """What a camera shows while a person captures."""
    np.save(CAPTURED, to_grey(SimulatedSensor().frame((), noise_seed=80).image)[None])


if __name__ == "__main__":
    for folder in (PAINTED, PRESSED):
        folder.mkdir(parents=True, exist_ok=True)
    make_painted()
    make_pressed()
    make_captured()
