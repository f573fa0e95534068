"""The demo's hand: five fingers hold a bottle that is pushed, turned,
and pulled until one finger slips.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.lab.parallel import workers
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.simulated_hand import (
    HandScript,
    Placement,
    SimulatedFinger,
    follow,
    lathed,
)
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.types import Calibration

HAND_ID: Final = "demo"
FPS: Final = 10
_MODEL: Final = SensorModel()

BOTTLE: Final = lathed("bottle", ((-80.0, 28.0), (16.0, 28.0), (42.0, 12.0), (96.0, 12.0)))
"""A bottle that at rest lies along the hand's x axis, its neck towards +x."""


@dataclass(frozen=True, slots=True)
class _Hold:
    """Where a finger holds the bottle at rest: the point that its tip touches,
    in the hand's frame at y = 0.
    """

    x_mm: float
    z_mm: float
    from_x: float  # direction from the point to the finger
    from_z: float
    depth_mm: float  # how far the undeformed tip would reach past the point
    yaw_deg: float  # rotation of the sensor about its own axis


FINGERS: Final = {
    "thumb": _Hold(-18.0, -30.0, 0.0, -1.0, 2.4, 0.0),
    "index": _Hold(76.0, 14.0, 0.1, 1.0, 2.0, 30.0),
    "middle": _Hold(27.0, 23.6, 0.45, 1.0, 1.8, -20.0),
    "ring": _Hold(-20.0, 30.0, 0.0, 1.0, 2.2, 15.0),
    "little": _Hold(-63.0, 30.0, -0.1, 1.0, 1.0, -35.0),
}
_BACK_MM: Final = 3.0  # how far open fingers stand back
STEP_S: Final = 0.2
"""Time between drawn steps of the motion: longer than the camera's frame period, to draw less."""
_SEEN: Final = "seen.png"  # the picture that a finger's camera reads repeatedly

_SETTINGS: Final = """\
hand_id: {hand_id}
shear: always
mqtt: {{host: 127.0.0.1, port: {port}, home_assistant: {announced}}}
recorder: {{folder: recordings}}
stitching: {{folder: sessions}}
sensors:
"""
_SENSOR: Final = """\
  {name}:
    calibration: {name}.npz
    source: {{kind: files, path: {name}/{seen}, fps: {fps}, loop: true}}
    hand_T_sensor: {place}
"""


def place_of(name: str) -> Rigid:
    hold = FINGERS[name]
    away = np.array((hold.from_x, 0.0, hold.from_z))
    away /= np.linalg.norm(away)
    yaw = turn((0.0, 0.0, float(np.radians(hold.yaw_deg))))
    # This turns the sensor's z axis, (0, 0, 1), to point inwards.
    inwards = turn((0.0, float(np.arctan2(-away[0], -away[2])), 0.0)) @ yaw
    middle = np.array((hold.x_mm, 0.0, hold.z_mm)) + (_MODEL.skin_radius_mm - hold.depth_mm) * away
    return Rigid(inwards.rotation, middle)


def script() -> HandScript:
    """One round: the bottle is grasped, pushed, turned, brought back, pulled until a finger slips,
    and released.
    """
    rests = shift(0.0, 0.0, 0.0)
    pushed = shift(0.0, 0.6, -0.25)
    turned = shift(0.0, 0.6, 0.0) @ turn((np.radians(2.5), np.radians(0.5), 0.0))
    pulled = shift(1.8, 0.0, 0.0)
    open_mm, closed_mm = (_BACK_MM,) * len(FINGERS), (0.0,) * len(FINGERS)
    begin = HandScript((0.0,), (Placement(rests, open_mm),)).held(1.2)
    grasped = begin.fingers_back(closed_mm, 1.0).held(1.0)
    moved = (
        grasped.moved(pushed, 0.8)
        .held(0.6)
        .moved(turned, 1.0)
        .held(0.8)
        .moved(rests, 0.8)
        .held(0.6)
    )
    return moved.moved(pulled, 1.6).held(1.0).fingers_back(open_mm, 1.0).moved(rests, 0.4)


_GRASPED_S: Final = 2.5  # no drawn step, whose picture has another name
_STEPS: Final = round(script().times_s[-1] / STEP_S)


def write(folder: Path, port: int, *, home_assistant: bool = False) -> Path:
    """Draw what the untouched fingers see into the demo's folder,
    and return the path of the hand's settings.
    """
    text = _SETTINGS.format(hand_id=HAND_ID, port=port, announced=str(home_assistant).lower())
    sensor = SimulatedSensor(_MODEL)
    for name in FINGERS:
        (folder / name).mkdir()
        cv2.imwrite(str(folder / name / _SEEN), sensor.picture(sensor.skin()))
        shutil.copyfile(folder / "calibration.npz", folder / f"{name}.npz")
        seven = [round(value, 6) for value in place_of(name).seven()]
        text += _SENSOR.format(name=name, seen=_SEEN, fps=FPS, place=seven)
    settings = folder / "hand.yaml"
    settings.write_text(text, encoding="utf-8")
    return settings


def play(folder: Path) -> Generator[None, None, None]:
    """Show the grasp, draw the round on all cores (half a minute of one), then play it;
    call `next` once per step.
    """
    shown, drawn = dict[str, Path](), list[list[Path]]()
    # First what the untouched and the grasping hand see, so that the page shows something at once.
    with workers() as pool:
        for times_s in ((0.0, _GRASPED_S), [k * STEP_S for k in range(_STEPS)]):
            drawn.clear()
            for pictures in pool.map(_draw, [(folder, name, times_s) for name in FINGERS]):
                drawn.append(pictures)
                yield
            _show(folder, drawn, 1, shown)
    begin_s = time.monotonic()
    while True:
        _show(folder, drawn, int((time.monotonic() - begin_s) / STEP_S) % _STEPS, shown)
        yield


def _show(folder: Path, drawn: Sequence[Sequence[Path]], step: int, shown: dict[str, Path]) -> None:
    """Replace the pictures of the fingers for which this step shows a different one."""
    for name, pictures in zip(FINGERS, drawn, strict=True):
        if shown.get(name) != pictures[step]:
            shown[name] = pictures[step]
            following = folder / name / f"next-{_SEEN}"
            # A link and a rename: the camera sees a whole picture at any moment, and nothing is
            # copied.
            os.link(pictures[step], following)
            following.replace(folder / name / _SEEN)


def _draw(task: tuple[Path, str, Sequence[float]]) -> list[Path]:
    """Draw what one finger sees at some times and return a path for each;
    those of the same skin share one.
    """
    folder, name = task[0] / task[1], task[1]
    sensor = SimulatedSensor(_MODEL)
    fingers = [SimulatedFinger(each, place_of(each), sensor) for each in FINGERS]
    round_of = script()
    placements = [round_of.at(time_s) for time_s in task[2]]
    by_skin, drawn = dict[int, Path](), list[Path]()
    # In a list, so that the skins live on and their ids differ.
    felts = list(follow(fingers, list(FINGERS).index(name), BOTTLE, placements))
    for k, felt in enumerate(felts):
        key = id(felt.skin) if felt.press else 0
        if key not in by_skin:
            # Named by its time, so that equal skins share a picture and the source need not read it
            # again.
            by_skin[key] = folder / f"{task[2][k]:05.2f}.png"
            picture = sensor.picture(felt.skin, noise_seed=k)
            # Level 1: a hundred pictures are written once and read often.
            cv2.imwrite(str(by_skin[key]), picture, (cv2.IMWRITE_PNG_COMPRESSION, 1))
        drawn.append(by_skin[key])
    return drawn


REFERENCES, PRESSES = 5, 20


def make_calibration() -> Calibration:
    """Calibrate the demo's simulated sensor; this takes one or two seconds."""
    model = SensorModel()
    simulated = SimulatedSensor(model)
    sensor = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
    )
    references = [simulated.frame(noise_seed=seed).image for seed in range(REFERENCES)]
    presses = []
    for k, (press, radius_mm) in enumerate(ball_presses(model, PRESSES)):
        image = simulated.frame([press], noise_seed=REFERENCES + k).image
        presses.append(
            KnownPress(f"press {k}", image, radius_mm, press.depth_mm, press.x_mm, press.y_mm)
        )
    return calibrate(sensor, references, presses).calibration
