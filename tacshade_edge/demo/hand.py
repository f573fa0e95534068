"""The demo's hand of five: fingers that close on a ball and let go, again and again, each a little after the last."""

from __future__ import annotations

import math
import os
import shutil
from pathlib import Path
from typing import Final

import cv2

from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor

HAND_ID: Final = "demo"
FPS: Final = 10
BALL_MM: Final = 40.0
# Where each finger is about the ball, in degrees from the hand's x towards its z.
FINGERS_DEG: Final = {"thumb": 250.0, "index": 150.0, "middle": 110.0, "ring": 70.0, "little": 30.0}
_DEPTHS_MM: Final = (0.4, 0.9, 1.4, 1.8, 2.0)
_HELD, _FREE, _LATE = 12, 14, 2  # frames at the deepest and without contact, and of each finger after the one before
_MODEL: Final = SensorModel()

_SETTINGS: Final = """\
hand_id: {hand_id}
shear: always
mqtt: {{host: 127.0.0.1, port: {port}}}
recorder: {{folder: recordings}}
stitching: {{folder: sessions}}
sensors:
"""
_SENSOR: Final = """\
  {name}:
    calibration: {name}.npz
    source: {{kind: files, path: {name}, fps: {fps}, loop: true}}
    hand_T_sensor: {place}
"""


def place_of(name: str) -> Rigid:
    """``hand_T_sensor``: the tip looks at the ball's middle, which is the hand's origin, and which it holds."""
    angle = math.radians(FINGERS_DEG[name])
    away_mm = BALL_MM + _MODEL.skin_radius_mm - _DEPTHS_MM[-1]
    # The sensor's z, (0, 0, 1), comes to point inwards.
    about_y = math.atan2(-math.cos(angle), -math.sin(angle))
    return shift(away_mm * math.cos(angle), 0.0, away_mm * math.sin(angle)) @ turn((0.0, about_y, 0.0))


def write(folder: Path, port: int) -> Path:
    """Draw what the fingers see, and write their settings; the path of these.

    Parameters
    ----------
    folder : Path
        Of the demo, with the calibration.
    port : int
        The broker's.
    """
    sensor = SimulatedSensor(_MODEL)
    drawn = folder / "drawn"
    drawn.mkdir()
    for k, depth_mm in enumerate((0.0, *_DEPTHS_MM)):
        presses = (Press(ball(BALL_MM), 0.0, 0.0, depth_mm),) if depth_mm else ()
        cv2.imwrite(str(drawn / f"{k}.png"), sensor.frame(presses, noise_seed=k).image)
    closing = list(range(1, len(_DEPTHS_MM) + 1))
    cycle = [0] * _FREE + closing + closing[-1:] * _HELD + closing[::-1]
    text = _SETTINGS.format(hand_id=HAND_ID, port=port)
    for late, name in enumerate(FINGERS_DEG):
        (folder / name).mkdir()
        for k in range(len(cycle)):
            os.link(drawn / f"{cycle[k - late * _LATE]}.png", folder / name / f"{k:02d}.png")
        shutil.copyfile(folder / "calibration.npz", folder / f"{name}.npz")
        seven = [round(value, 6) for value in place_of(name).seven()]
        text += _SENSOR.format(name=name, fps=FPS, place=seven)
    settings = folder / "hand.yaml"
    settings.write_text(text, encoding="utf-8")
    return settings
