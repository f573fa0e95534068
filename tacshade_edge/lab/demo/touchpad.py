"""The demo's other sensor: a robot repeatedly presses it all over a small pad,
and the daemon stitches the presses.
"""

from __future__ import annotations

import itertools
import shutil
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import cv2

from tacshade_edge.errors import DeviceError
from tacshade_edge.lab.simulator.pad import Arc, Bar, Dot, Pad, scan
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.mqtt.caller import MqttCaller
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.recording.frame_table import HEADER, TABLE_NAME
from tacshade_edge.rigid import Rigid

SENSOR_ID: Final = "demo-map"
FPS: Final = 10
_MODEL: Final = SensorModel()
_PAD: Final = Pad(
    36.0, 28.0, (Arc(11.1, 14.1, 7.0, 3.0), Bar(23.1, 4.1, 23.1, 24.1, 2.0), Dot(31.1, 14.1, 3.0))
)
# Presses overlap: the map joins them by the parts that they share.
_STEP_MM: Final = 6.0
_DEPTH_MM: Final = 2.7
_HELD, _FREE = 6, 3  # frames of a press and of the move to the next
_AT_ONCE = 3  # presses drawn before the demo looks after its other processes
_BEGIN_S, _END_S = 5.0, 30.0
_SHOWN_S = 20.0  # how long a finished map stays before the next begins

_SETTINGS: Final = """\
sensor_id: {sensor_id}
calibration: calibration.npz
source: {{kind: files, path: pad, fps: {fps}, loop: true}}
recorder: {{folder: recordings}}
stitching: {{folder: sessions}}
mqtt: {{host: 127.0.0.1, port: {port}}}
"""


def hand(folder: Path, port: int, start: Callable[[Path], object]) -> Generator[None, None, None]:
    """Draw the presses, start a daemon that reads them, and have it stitch;
    each `next` does a little more.
    """
    yield from _presses(folder / "pad")
    settings = folder / f"{SENSOR_ID}.yaml"
    settings.write_text(_SETTINGS.format(sensor_id=SENSOR_ID, fps=FPS, port=port), encoding="utf-8")
    start(settings)
    # As any program of a user would, through the broker: the demo has no way of its own.
    broker = BrokerAddress(host="127.0.0.1", port=port, username=None, password=None, tls_ca=None)
    caller = MqttCaller(broker, sensor_id=SENSOR_ID, verb="stitch", watched=("state",))
    try:
        caller.start()
        # Until then, the daemon would not hear a request.
        while caller.latest("state") != b"online":
            yield
        for number in itertools.count(1):
            end_s = time.monotonic() + len(_poses()) * (_HELD + _FREE) / FPS
            with suppress(DeviceError):  # a user of the page began a session
                caller.ask({"action": "begin", "name": f"pad-{number}"}, _BEGIN_S)
            while time.monotonic() < end_s:
                yield
            with suppress(DeviceError):  # a user of the page ended the session
                caller.ask({"action": "end"}, _END_S)
            shutil.rmtree(folder / "sessions" / f"pad-{number - 1}", ignore_errors=True)
            end_s = time.monotonic() + _SHOWN_S
            while time.monotonic() < end_s:
                yield
    finally:
        caller.stop()


def _poses() -> list[Rigid]:
    return scan(_PAD, _STEP_MM, _DEPTH_MM, _MODEL.skin_radius_mm)


def _presses(folder: Path) -> Iterator[None]:
    """Write the frames of one pass over the pad and their frame table;
    yield after every few presses.
    """
    sensor = SimulatedSensor(_MODEL)
    folder.mkdir()
    cv2.imwrite(str(folder / "free.png"), sensor.frame().image)
    lines, t_ns = [",".join(HEADER)], 0
    for k, pose in enumerate(_poses()):
        press = Press(_PAD.under(pose, _MODEL.skin_radius_mm), 0.0, 0.0, 0.0)
        name, place = f"press_{k:02d}.png", ",".join(f"{value:.6f}" for value in pose.seven())
        cv2.imwrite(str(folder / name), sensor.frame((press,), noise_seed=k).image)
        # Frames between presses have no pose, as those of a robot that moves have none that counts.
        for image, pose_columns in [("free.png", ",,,,,,")] * _FREE + [(name, place)] * _HELD:
            lines.append(f"{image},{t_ns},{pose_columns}")
            t_ns += 1_000_000_000 // FPS
        if k % _AT_ONCE == 0:
            yield
    (folder / TABLE_NAME).write_text("\n".join(lines) + "\n", encoding="utf-8")
