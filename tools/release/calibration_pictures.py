#!/usr/bin/env python3
"""The pictures of calibration.md: the simulated sensor's, and the page of a capture of it, in a headless browser.

::

    .venv/bin/python -m tools.release.calibration_pictures [DIR]

DIR is docs/images unless given. Prints what `capture` says of each picture of the sensor.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
from selenium.webdriver.common.by import By

from tacshade_edge.core.calibration.reference.view import find_pattern, view
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.types import U8
from tools.testbed.browser import browser
from tools.testbed.patience import wait_until
from tools.testbed.person import person
from tools.testbed.simulator import camera_faults

SHOWN_PX = (320, 240)
PRESS = ("ball", "6", "2.5", "1", "-3")
"""The press as hand.csv has it and as a person types it."""
PAGE_PX = (760, 1040)
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 85)


def views() -> dict[str, U8]:
    """The camera's images: a good one, three kinds of bad ones, and a press."""
    sensor = SimulatedSensor()
    good = to_grey(sensor.frame().image)
    _, radius_mm, depth_mm, x_mm, y_mm = PRESS
    touching = Press(ball(float(radius_mm)), float(x_mm), float(y_mm), float(depth_mm))
    return {
        "good": good,
        "unsharp": camera_faults.defocus(good, 2.5),
        "bright": nuisance.gain(good, 3.0),
        "dark": nuisance.gain(good, 0.17),
        "pressed": to_grey(sensor.frame((touching,)).image),
    }


def told(grey: U8) -> str:
    """The report of `capture` on a picture."""
    try:
        seen = view(grey, find_pattern(grey))
    except ConfigError as error:
        return f"no disc: {error}"
    figures = (
        f"focus {seen.focus:.3f} | contrast {seen.contrast_grey:.0f} | saturated {100 * seen.saturated_part:.0f} %"
    )
    return f"{seen.advice} | {figures}" if seen.advice else figures


def show_page(path: Path) -> None:
    """Draw the page of a capture as it continues after a press."""
    with tempfile.TemporaryDirectory() as name:
        folder, model = Path(name), SensorModel()
        out = folder / "mysensor"
        out.mkdir()
        (folder / "sim.yaml").write_text("source: {kind: simulated, fps: 10, pressed: hand.csv}\n")
        (out / "SENSOR.yaml").write_text(
            f"skin_radius_mm: {model.skin_radius_mm}\nvisible_half_angle_deg: {model.visible_half_angle_deg}\n"
            f"camera_distance_mm: {model.camera_distance_mm}\npolarity: bright\n"
        )
        hand, header = folder / "hand.csv", "indenter,radius_mm,depth_mm,x_mm,y_mm\n"
        hand.write_text(header)
        with person(str(out), "--config", str(folder / "sim.yaml")) as one, browser(folder, size_px=PAGE_PX) as driver:
            one.hears("live picture: ")
            one.hears("\n")
            address = one.before.strip()
            one.hears("Enter takes 10 references.")
            one.types("")
            one.hears("press 1 (ball")
            part = folder / "hand.part"
            part.write_text(f"{header}{','.join(PRESS)}\n")
            os.replace(part, hand)
            one.types(" ".join(PRESS))
            one.hears("press_001.png")
            driver.get(address)
            text = driver.find_element(By.ID, "text")
            wait_until(lambda: "the next press helps most" in text.text, 10, "the page tells what helps next")
            picture = np.frombuffer(driver.get_screenshot_as_png(), np.uint8)
            cv2.imwrite(str(path), cv2.imdecode(picture, cv2.IMREAD_COLOR), JPEG)
            one.types("done")
            one.ends()


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description="The pictures of calibration.md.")
    folder = Path(__file__).resolve().parents[2] / "docs/images"
    parser.add_argument("folder", type=Path, nargs="?", default=folder, metavar="DIR", help="docs/images")
    folder = parser.parse_args().folder
    for name, grey in views().items():
        print(f"{name}: {told(grey)}")
        small = cv2.resize(grey, SHOWN_PX, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / f"calibration-{name}.jpg"), small, JPEG)
    show_page(folder / "capture.jpg")


if __name__ == "__main__":
    main()
