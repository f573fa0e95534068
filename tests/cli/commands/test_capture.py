"""A person who presses the simulated sensor."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from support.patience import wait_until
from support.person import Person, person
from support.robot import PtyRobot
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.files.capture_folder import CaptureFolder
from tacshade_edge.calibration.files.press_table import read_presses
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.cli import main
from tacshade_edge.cli.commands.capture import LEAST_TOUCHES
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.settings import load

PLAN = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
Press = Callable[..., None]


@pytest.mark.slow
def test_a_pad_is_described_by_what_it_has(tmp_path: Path, config: Path) -> None:
    out = tmp_path / "pad"
    with person(str(out), "--config", str(config)) as one:
        one.hears("Radius of the undeformed skin, mm (pad: the skin is flat)")
        one.types("pad")
        one.hears("Radius of the circle of skin that the camera sees")
        one.types("-3")
        one.hears("visible_radius_mm: found -3, expected a number from 1 to 200")
        for answer in ("15", "27", ""):
            one.types(answer)
        one.hears("live picture: http://127.0.0.1:")
    sensor = read_sensor(out / "SENSOR.yaml")
    assert (sensor.pad_radius_mm, sensor.camera_distance_mm, sensor.polarity) == (15, 27, None)


@pytest.mark.slow
def test_from_an_empty_folder_to_what_calibrate_reads(
    tmp_path: Path, config: Path, press: Press
) -> None:
    plan, out = tmp_path / "PLAN.csv", tmp_path / "my sensor"
    plan.write_text(PLAN + ",ball,6,2.5,1,-3\n,ball,4,2,-5,2\n")
    with person(str(out), "--config", str(config), "--plan", str(plan)) as one:
        describes_the_sensor(one)
        takes_references(one, press)
        shows_rest_and_a_touch(one, press)
        takes_a_press_again_and_again(one, press)
        one.process.terminate()
        one.ends()
    folder = CaptureFolder(out)
    assert len(folder.rest_pictures()) >= 20
    (touch,) = folder.touch_pictures()
    for _ in range(LEAST_TOUCHES - 1):
        folder.add_touch(folder.picture(touch))
    with person(str(out), "--plan", str(plan)) as one:  # goes on, with the same camera
        goes_on_to_the_end(one)
        assert (
            f"--sensor '{out}'/SENSOR.yaml --reference '{out}'/reference_*.png "
            f"--rest '{out}'/rest --fit --touches '{out}'/touches --out" in one.heard
        )
        assert f"\r\n  tacshade-edge run --config '{out}'/config.yaml\r\n" in one.heard
        assert "2 presses: " in one.heard
    presses, _ = read_presses(folder.presses)
    assert [(one.radius_mm, one.depth_mm, one.x_mm, one.y_mm) for one in presses] == [
        (6, 2.5, 1, -3)
    ] * 2
    settings = load(folder.settings).settings
    assert settings.calibration == str(out / "calibration.npz")
    assert settings.recorder.folder == str(out / "recordings")  # the default is the service's
    calibrate(read_sensor(folder.sensor), folder.references())


def describes_the_sensor(one: Person) -> None:
    one.hears("Radius of the undeformed skin")
    one.types("0.02")
    one.hears("skin_radius_mm: found 0.02, expected a number from 1 to 10000")
    model = SensorModel()
    for answer in (
        model.skin_radius_mm,
        model.visible_half_angle_deg,
        model.camera_distance_mm,
        "bright",
    ):
        one.types(str(answer))


def takes_references(one: Person, press: Press) -> None:
    one.hears("live picture: http://127.0.0.1:")
    one.hears("Enter takes 10 references.")
    one.hears("focus 0.")
    press("ball,6,2.5,9,0")
    one.types("")
    one.hears("rejected: ")  # by whichever of the checks sees it: moving or loaded
    press()
    one.hears("Enter takes 10 references.")
    one.types("")
    one.hears("10 references, noise")


def shows_rest_and_a_touch(one: Person, press: Press) -> None:
    one.hears("of the untouched sensor show where a touch begins")
    one.hears("skip leaves it out:")
    one.types("")
    one.hears("untouched sensor: 6 of 45 s")
    one.types("")
    one.hears("of the untouched sensor in ")
    one.hears("20 touches of anything, anywhere")
    one.types("")
    one.hears("touch 1 of 20: touch the skin")
    press("ball,6,2.5,-4,2")
    one.hears("touch 2 of 20: touch elsewhere")
    press()
    one.hears("touch 2 of 20: touch the skin")
    one.types("")
    one.hears("1 unlabelled touch")


def takes_a_press_again_and_again(one: Person, press: Press) -> None:
    one.hears("press 1, 2 planned presses left [ball of 6 mm, 2.5 mm deep at x 1, y -3 mm]:")
    one.types("")
    one.hears("not taken: nothing touches the skin")
    press("ball,6,2.5,1,-3")
    one.types("")
    one.hears("press_001.png: ball of 6 mm")
    one.types("undo")
    one.hears("removed press_001.png")
    one.types("ball 12 2.5 1 -3")
    one.hears("press_001.png: ball of 12 mm")
    # The noise decides on the radius.
    about = [f"this looks like a ball of about {radius} mm: is " for radius in (5, 6, 7)]
    one.hears(*about)
    one.hears("12 mm its diameter? (undo removes the press)")
    one.types("undo")
    one.hears("removed press_001.png")
    one.types("ball 3 2.5 1 -3")
    one.hears(*about)
    one.hears("its radius 3 mm?")
    # Not the one of 12 mm.
    one.hears("press 2, 2 planned presses left [ball of 6 mm, 2.5 mm deep at x 1, y -3 mm]:")
    one.types("undo")
    one.hears("press 1, 2 planned presses left [ball of 3 mm")
    one.types("skip")
    one.types("ball 6 2.5 1 15 15")
    one.hears("found 4 values after the indenter")
    one.types("bal 6 2 -1 6")
    one.hears("indenter: found 'bal', expected ball")
    one.types("")
    one.hears("press_001.png: ball of 6 mm")
    one.hears("press 2, 1 planned press left [ball of 4 mm")


def goes_on_to_the_end(one: Person) -> None:
    one.hears("this folder already has 10 references and 1 press\r\n")
    one.hears("20 touches of anything, anywhere")
    one.types("skip")
    one.hears("press 2, 1 planned press left [ball of 4 mm, 2 mm deep at x -5, y 2 mm]:")
    one.types("skip")
    one.hears("press 2 (ball RADIUS_MM")
    one.types("2.5 1 -3")
    one.hears("press_002.png: ball of 6 mm, 2.5 mm deep at x 1, y -3 mm")
    one.types("done")
    assert one.ends() == 0


def test_as_many_touches_are_passed_on_as_a_fit_needs() -> None:
    explained = pytest.importorskip("tacshade_edge.lab.fitting.explained", exc_type=ImportError)
    assert explained.LEAST_TOUCHES == LEAST_TOUCHES


NO_POSE = "not taken: the robot reported no pose for this picture"


def takes(one: Person, line: str, shown: str) -> None:
    """Type a press until it is taken: on a busy machine the robot's poses may be late,
    and a person tries again.
    """
    for _ in range(5):
        one.types(line)
        if one.hears(shown, NO_POSE) == shown:
            return
    raise AssertionError(f"{line!r}: {NO_POSE}, five times")


def held_twice(flange_T_sensor: Rigid) -> tuple[list[tuple[float, ...]], str]:
    """The flange's two places at which the sensor meets a ball that stands still: 2.5 mm deep at
    (1, -3), and at (4, -4.5) so deep as is returned.
    """
    held = shift(300, -20, 150) @ turn((2.0, 0.3, 0)) @ flange_T_sensor
    moved = held @ shift(-3, 1.5, 0.5)
    r_mm = SensorModel().skin_radius_mm
    skin_z_mm = [math.sqrt(r_mm**2 - x * x - y * y) for x, y in ((1, -3), (4, -4.5))]
    flange = [(one @ flange_T_sensor.inverse()).seven() for one in (held, moved)]
    return flange, f"{2.5 + 0.5 + skin_z_mm[1] - skin_z_mm[0]:.3f}"


def goes_to_the_presses(one: Person) -> None:
    one.hears("Enter takes 10 references.")
    one.types("")
    for _ in ("rest", "touches"):
        one.hears("skip leaves it out:")
        one.types("skip")
    one.hears("press 1 (ball")


@pytest.mark.slow
def test_a_robot_states_place_and_depth(
    tmp_path: Path, config: Path, press: Press, sensor_yaml: str
) -> None:
    """It holds the sensor, turned and off its flange,
    and presses it on a ball that stands still.
    """
    link, out = Path(f"/dev/shm/tacshade-capture-{os.getpid()}"), tmp_path / "out"
    config.write_text(f"{config.read_text()}serial: {{device: {link}}}\n")
    flange_T_sensor = shift(0, 5, 80) @ turn((0, 0, 0.5))
    out.mkdir()
    (out / "SENSOR.yaml").write_text(
        f"{sensor_yaml}flange_T_sensor: {list(map(float, flange_T_sensor.seven()))}\n"
    )
    flange, depth_mm = held_twice(flange_T_sensor)
    place = flange[0]
    with (
        PtyRobot(link, rate_hz=50, binary=True, where=lambda _: place) as robot,
        person(str(out), "--config", str(config)) as one,
    ):
        goes_to_the_presses(one)
        robot.ask("CAPTURE")
        wait_until(
            lambda: any(" UNCALIBRATED " in reply for reply in robot.replies.values()),
            10,
            "the refusal",
        )
        press("ball,6,2.5,1,-3")
        one.types("ball 6")
        one.hears("found no press of ball in this run, expected a first press with depth, x and y")
        one.types("ball 6 2.5 1 -3")
        one.hears("press_001.png: ball of 6 mm, 2.5 mm deep at x 1, y -3 mm")
        one.hears("press 2 [ball 6, where the robot holds it]:")
        place = flange[1]
        press(f"ball,6,{depth_mm},4,-4.5")
        takes(one, "", "press_002.png: ball of 6 mm, ")
        one.types("undo")
        one.hears("press 2 [ball 6, where the robot holds it]:")
        takes(one, "ball 6", "press_002.png: ball of 6 mm, ")
        robot.unplug()
        one.types("")
        one.hears(f"{NO_POSE} (/dev/shm/tacshade-capture-")
        one.types("done")
        assert one.ends() == 0
    link.unlink(missing_ok=True)
    columns = CaptureFolder(out).taken()[1].stated.columns
    assert [float(text) for text in columns[1:]] == pytest.approx(
        [6, float(depth_mm), 4, -4.5], abs=0.002
    )
    assert load(out / "config.yaml").settings.serial is not None


def test_what_cannot_work_is_one_line(
    tmp_path: Path, config: Path, sensor_yaml: str, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "SENSOR.yaml").write_text(sensor_yaml)
    (tmp_path / "PLAN.csv").write_text("image,indenter\n")
    (tmp_path / "none.yaml").write_text("source: {kind: files, path: nothing}\n")
    cases = {
        "PLAN.csv:1: found the header": [
            "--config",
            str(config),
            "--plan",
            str(tmp_path / "PLAN.csv"),
        ],
        "found nothing, expected a folder of images": ["--config", str(tmp_path / "none.yaml")],
        "--camera /dev/none: found another source in": ["--camera", "/dev/none"],
        "--scale: found no --labels DIR": ["--scale", "/dev/ttyUSB0"],
    }
    (out / "config.yaml").write_text(config.read_text())
    for said, words in cases.items():
        assert main(["capture", str(out), *words]) == 78
        error = capfd.readouterr().err
        assert error.count("\n") == 1
        assert said in error
    assert main(["capture", "--labels", str(out), "--plan", "PLAN.csv"]) == 78
    assert "--labels: found --plan" in capfd.readouterr().err
