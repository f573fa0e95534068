"""A person who labels frames of the simulated sensor:
by typing, with a scale that a pty plays, with a robot.
"""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.person import Person, person
from support.robot import PtyRobot
from tacshade_edge.calibration.files.labels import LabelledImage, read_labels
from tacshade_edge.rigid import shift, turn

Press = Callable[..., None]
LATE_S = 0.3
WEIGHT_KG = 0.15


class PtyScale:
    """Twenty lines a second on a pty; what is put on it shows `LATE_S` later."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.device = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._loads = [(0.0, 0.0)]
        self._thread = threading.Thread(target=self._run)

    def put(self, kg: float) -> None:
        self._loads.append((time.monotonic() + LATE_S, kg))

    def __enter__(self) -> PtyScale:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)

    def _run(self) -> None:
        while not self._stop.wait(0.05):
            now_s = time.monotonic()
            kg = next(kg for from_s, kg in reversed(self._loads) if from_s <= now_s)
            os.write(
                self._master, f"ST,GS,{kg + 0.012:+8.3f}kg\r\n".encode()
            )  # it was not set to zero


@pytest.fixture
def out(tmp_path: Path, sensor_yaml: str) -> Path:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "SENSOR.yaml").write_text(sensor_yaml)
    return tmp_path / "out"


def labelled(out: Path) -> list[LabelledImage]:
    return read_labels(out / "LABELS.csv", out)


def rested(one: Person) -> None:
    one.hears("Enter takes rest")
    one.types("")


def presses(one: Person, press: Press, scale: PtyScale, numbers: range) -> Iterator[str]:
    """Press and lift while it is recorded; what it is taken as."""
    pause = threading.Event()
    for number in numbers:
        one.hears(f"press {number} (Enter")
        one.types("")
        one.hears("press, then lift")
        pause.wait(0.5)
        press("ball,6,2.5,1,-3")
        scale.put(WEIGHT_KG)
        pause.wait(1.2)
        press()
        scale.put(0)
        pause.wait(0.8)
        one.types("")
        yield one.hears(f"press {number}: ")


@pytest.mark.slow
def test_readings_that_are_typed(out: Path, config: Path, press: Press) -> None:
    with person("--labels", str(out), "--config", str(config)) as one:
        rested(one)
        one.hears("press 1 (Enter, NAME=VALUE ...")
        for words, why in (
            (
                "",
                (
                    "found nothing, expected NAME=VALUE ..., "
                    "because there is neither a scale nor a robot"
                ),
            ),
            ("force_n=1", "found 'force_n=1', expected NAME=VALUE, where NAME is one of depth_mm,"),
            ("force_z_n=much", "press: force_z_n: found 'much', expected a number"),
            ("force_z_n=1 force_z_n=2", "force_z_n: found two values, expected one value"),
            ("touch", "found no robot, expected serial in the settings"),
            ("undo", "nothing to undo since the start"),
        ):
            one.types(words)
            one.hears(why)
        one.types("force_z_n=1.2 depth_mm=0.5")
        one.hears("press 1: 1 picture with depth_mm, force_z_n")
        one.types("force_z_n=2")
        one.hears("press 2: 1 picture with force_z_n")
        one.types("undo")
        one.hears("removed press 2: 1 picture")
        one.types("done")
        assert one.ends() == 0
        assert f"--labels {out}/LABELS.csv --out {out}/calibration.npz" in one.heard
    (first,) = labelled(out)
    assert (first.path.name, first.known, first.group) == (
        "label_00001.png",
        {"force_z_n": 1.2, "depth_mm": 0.5},
        "1",
    )
    assert sorted(path.name for path in out.glob("*.png")) == ["label_00001.png"]
    with person("--labels", str(out)) as one:  # goes on, with the same camera
        one.hears("this folder already has 1 labelled picture\r\n")
        rested(one)
        one.types("twist_deg=-3")
        one.hears("press 2: 1 picture with twist_deg")
        one.process.terminate()
        one.ends()
    assert [(row.known, row.group) for row in labelled(out)] == [
        (first.known, "1"),
        ({"twist_deg": -3.0}, "2"),
    ]


@pytest.mark.slow
def test_a_scale_is_lined_up_with_the_pictures(out: Path, config: Path, press: Press) -> None:
    with (
        PtyScale() as scale,
        person("--labels", str(out), "--config", str(config), "--scale", scale.device) as one,
    ):
        rested(one)
        one.hears(f"tare: the scale reads {0.012 * 9.80665:.4f} N, spread 0.0000 N")
        for _ in presses(one, press, scale, range(1, 6)):
            pass
        one.types("done")
        one.hears("scale: subtracted the tare of 0.1177 N")
        one.hears("scale: its readings come ")
        one.hears(" presses")
        late_ms, error_ms = (
            float(one.before.split()[0]),
            float(one.before.split("standard error ")[1].split()[0]),
        )
        assert one.ends() == 0
    assert error_ms < 50
    # A picture is taken up to a frame after the hand has moved,
    # a reading up to a twentieth of a second later.
    assert 1e3 * LATE_S - 75 < late_ms < 1e3 * LATE_S + 75
    rows = labelled(out)
    assert {row.group for row in rows} == {"1", "2", "3", "4", "5"}
    weight_n = WEIGHT_KG * 9.80665
    near = [row for row in rows if abs(row.known["force_z_n"] - weight_n) < 0.01]
    assert len(near) > 0.5 * len(rows) >= 5  # a slow machine takes fewer pictures of a press
    assert all(-0.01 < row.known["force_z_n"] < weight_n + 0.01 for row in rows)


@pytest.mark.slow
def test_a_robots_poses_label_a_press(out: Path, config: Path, press: Press) -> None:
    link = Path(f"/dev/shm/tacshade-labels-{os.getpid()}")
    with config.open("a") as settings:
        settings.write(f"serial: {{device: {link}}}\n")
    first = shift(300, -20, 150) @ turn((2.0, 0.3, 0))
    place = first.seven()
    with (
        PtyRobot(link, rate_hz=50, binary=True, where=lambda _: place),
        person("--labels", str(out), "--config", str(config)) as one,
    ):
        rested(one)
        one.hears("press 1 (Enter")
        one.types("")
        one.hears("found nothing, expected touch first")
        one.types("touch")
        one.hears("set first touch here")
        one.types("")
        one.hears("press, then lift")
        place = (first @ shift(0.5, -0.25, 1.5)).seven()
        pause = threading.Event()
        pause.wait(0.5)
        press("ball,6,1.5,0,0")
        pause.wait(2.0)
        press()
        pause.wait(0.2)
        one.types("")
        one.hears("press 1: ")
        one.hears(
            "pictures with depth_mm, tilt_x_deg, tilt_y_deg, shear_x_mm, shear_y_mm, twist_deg"
        )
        one.types("done")
        assert one.ends() == 0
    link.unlink(missing_ok=True)
    rows = labelled(out)
    assert len(rows) > 4
    still = dict.fromkeys(("tilt_x_deg", "tilt_y_deg", "twist_deg"), 0.0)
    known = pytest.approx(
        {"depth_mm": 1.5, "shear_x_mm": -0.5, "shear_y_mm": 0.25, **still}, abs=1e-3
    )
    assert all(row.known == known for row in rows)
