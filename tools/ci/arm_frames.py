"""The results of the same frames on this machine;
``tools/ci/run_arm.py`` runs it here and on the other machine.

::

    arm_frames.py write FOLDER
    arm_frames.py reconstruct FOLDER OUT
    arm_frames.py step FOLDER PROFILE PORT [last]

``write`` makes calibration.npz, images.npy and images: a free skin, then presses. ``reconstruct``
writes each profile's result of each image to OUT.npz. ``step`` takes the frames of `stages_of`, or
the last of each image, `COUNT` times each between two marks, at which tools/rig/count_instructions
counts; PORT is that of a broker on this machine.
"""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.mqtt.client import broker_at
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.mqtt.publishing import Publisher
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import step_and_track
from tacshade_edge.types import Frame, Need

DEPTHS_MM = (0.6, 1.5, 3.0, 4.5)
FREE, PRESSED = 0, 3
"""Indices in images.npy."""
COUNT = 5
MARK = 0x7AC5ADE
"""Of tools/rig/count_instructions.c."""


def write(folder: Path) -> None:
    """Write simulated images; only on this machine, as the other one would need minutes."""
    from tacshade_edge.lab.simulator.press import OBJECTS, Press
    from tacshade_edge.lab.studies.evaluate.work import SensorName, calibrated
    from tacshade_edge.sensor.image.greyscale import to_grey

    name = SensorName.parse("default")
    calibration_file.save(folder / "calibration.npz", calibrated(name, 8, 20).calibration)
    sensor = name.make()
    presses = [
        (Press(OBJECTS["cube"](), 0.0, 0.0, depth_mm, 20.0, 1.45),) for depth_mm in DEPTHS_MM
    ]
    images = [to_grey(sensor.frame(press, seed).image) for seed, press in enumerate([(), *presses])]
    np.save(folder / "images.npy", np.stack(images))
    (folder / "images").mkdir(exist_ok=True)
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / f"images/{k}.png"), image)


def reconstruct(folder: Path, out: Path) -> None:
    """Write the binary image, where integer arithmetic ends, and the maps."""
    calibration, images = (
        calibration_file.load(folder / "calibration.npz"),
        np.load(folder / "images.npy"),
    )
    found: dict[str, Any] = {}
    for name, profile in PROFILES.items():
        made, preprocessor = (
            make_reconstructor(calibration, profile),
            Preprocessor(calibration, profile),
        )
        for k, image in enumerate(images):
            total = preprocessor.preprocess(preprocessor.grey(image)).white
            found[f"{name} {k} white"] = np.diff(np.diff(total, axis=0), axis=1).astype(np.uint8)
            result = made.step(Frame(k, k, k, image))
            found[f"{name} {k} height"] = result.height.height_mm
            found[f"{name} {k} contact"] = result.height.contact
            if result.shear_mm is not None:
                found[f"{name} {k} shear"] = result.shear_mm
    np.savez(out, **found)


STAGES: dict[str, Need] = {
    "gate": Need.CONTACT,
    "depth": Need.DEPTH,
    "shear": Need.SHEAR,
    "sigma": Need.SHEAR | Need.SIGMA,
    "encode": Need.SHEAR | Need.SIGMA,
    "publish": Need.SHEAR | Need.SIGMA,
}
"""Up to the gate; with depth, objects and cloud; and so on.

`encode` makes all payloads, `publish` sends them.
"""


def stages_of(profile: str, image: int) -> list[str]:
    """The stages of a frame, in order."""
    if image == FREE:
        return ["gate"]
    return [stage for stage in STAGES if profile != "paper" or stage not in ("shear", "sigma")]


def mark() -> None:
    """Make the emulator print how many instructions it has executed."""
    with suppress(ProcessLookupError):
        os.getpgid(MARK)


class Steps:
    """Frames of one profile, processed as the daemon does for subscribers."""

    def __init__(self, folder: Path, profile: str, port: int) -> None:
        self._calibration = calibration_file.load(folder / "calibration.npz")
        self._profile = PROFILES[profile]
        self._images = np.load(folder / "images.npy")
        self._sent = threading.Semaphore(0)
        self._link = MqttLink(
            broker_at("127.0.0.1", port),
            base_topic="tacshade/counted",
            client_id="counted",
            on_request=lambda _: None,
            on_outcome=lambda *_: self._sent.release(),
        )

    def run(self, image: int, last: str) -> None:
        """Process an image up to stage `last`: once, then `COUNT` times between two marks."""
        made, tracker = make_reconstructor(self._calibration, self._profile), ContactTracker()
        offered = 0

        def offer(stream: str, payload: bytes, seq: int) -> None:
            nonlocal offered
            if last == "publish":
                offered += 1
                self._link.offer(stream, payload, seq)

        publisher = Publisher(offer, lambda *_: None, lambda *_: None)
        for k in range(1 + COUNT):
            if k == 1:
                mark()
            frame = Frame(k, 16_666_667 * k, 0, self._images[image])
            result = step_and_track(made, tracker, frame, need=STAGES[last])
            if last in ("encode", "publish"):
                publisher.see(FrameResult(frame, self._calibration, result, 0.0))
            for _ in range(offered):
                self._sent.acquire()
            offered = 0
        mark()

    def connect(self) -> None:
        """Wait until the broker has answered, however slow this processor is."""
        self._link.start()
        self._link.wait_until_settled(threading.TIMEOUT_MAX)

    def close(self) -> None:
        """Disconnect."""
        self._link.stop(2.0)


def step(folder: Path, profile: str, port: int, *, only_last: bool) -> None:
    """Process the frames whose instructions are counted, in the order of `stages_of`."""
    steps = Steps(folder, profile, port)
    for image in (FREE, PRESSED):
        for stage in stages_of(profile, image)[-1 if only_last else 0 :]:
            if stage == "publish":
                steps.connect()  # not before: its pings would count
            steps.run(image, stage)
    steps.close()


if __name__ == "__main__":
    cv2.setNumThreads(1)
    what, where, *rest = sys.argv[1:]
    if what == "write":
        write(Path(where))
    elif what == "reconstruct":
        reconstruct(Path(where), Path(rest[0]))
    else:
        step(Path(where), rest[0], int(rest[1]), only_last=rest[2:] == ["last"])
