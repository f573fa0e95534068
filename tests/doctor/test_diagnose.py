from __future__ import annotations

import os
import socket
import time
from pathlib import Path
from typing import Any

import cv2
import pytest

from tacshade_edge.doctor.diagnose import CAPTURE_S, JUDGE_S, MACHINE_S, NODE_S, diagnose
from tacshade_edge.doctor.finding import Finding
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import free_port
from tools.testbed.painted_sensor import FREE, painted_calibration
from tools.testbed.patience import stretched


@pytest.fixture
def config(tmp_path: Path) -> Path:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    cv2.imwrite(str(tmp_path / "a.png"), FREE)
    path = tmp_path / "s.yaml"
    path.write_text(
        f"calibration: c.npz\nmqtt: {{port: {free_port()}}}\n"
        "source: {kind: files, path: a.png, fps: 240, loop: true}\n"
    )
    return path


def checked(config: Path, machine: Any) -> dict[str, Finding]:
    found: dict[str, Finding] = {}
    for finding in diagnose(config, machine):
        assert bool(finding.fix) == (finding.state != "ok"), finding
        assert "\n" not in finding.found + finding.fix, "a line"
        found[finding.check] = finding
    return found


def test_every_subject_is_checked_whatever_another_says(config: Path, machine: Any) -> None:
    found = checked(config, machine)
    assert {"settings", "broker", "serial", "disk", "clock", "source", "picture", "calibration", "sensor"} <= set(found)
    assert found["settings"].state == "ok"
    assert "refused: nothing is listening" in found["broker"].found
    assert "daemon" not in found, "nobody to ask"
    assert found["sensor"].found == "the image matches the calibration and shows no contact"


def test_bad_settings_come_first_and_the_machine_is_checked(config: Path, machine: Any) -> None:
    config.write_text("sensor: 1\n")
    found = checked(config, machine)
    assert next(iter(found)) == "settings"
    assert found["settings"].state == "fault"
    assert set(found) == {"settings", "serial", "disk", "clock", "camera"}


def test_the_cameras_of_all_sensors_are_counted_on_usb(config: Path, machine: Any) -> None:
    own = "source: {kind: v4l2, fourcc: YUYV, device: /dev/video90%d}"
    names = [f"  f{k}: {{calibration: c{k}.npz, {own % k}}}" for k in range(3)]
    config.write_text("\n".join([f"mqtt: {{port: {free_port()}}}", "sensors:", *names]) + "\n")
    for k in range(3):
        machine.put(f"/dev/video90{k}")
        usb = f"/sys/devices/usb1/1-1/1-1.{k}"
        machine.put(f"{usb}/speed", "480")
        machine.put(f"{usb}/1-1.{k}:1.0/driver")
        machine.link(f"/sys/class/video4linux/video90{k}/device", f"../../../..{usb}/1-1.{k}:1.0")
    found = {finding.check: finding for finding in diagnose(config, machine, sensor_id="f0")}
    assert found["usb"].state == "fault"
    assert "3 cameras" in found["usb"].found


def test_without_the_camera_the_calibration_is_read(config: Path, machine: Any) -> None:
    config.write_text("calibration: c.npz\nsource: {kind: v4l2, width_px: 160, height_px: 120}\n")
    found = checked(config, machine)
    assert found["camera"].found == "/dev/video0: no such device"
    assert found["calibration"].state == "ok"
    assert "sensor" not in found


def test_a_check_that_breaks_is_one_fault(config: Path, machine: Any) -> None:
    machine.put("/sys/devices/platform/soc/soc:firmware/get_throttled", "not a number")
    found = checked(config, machine)
    assert found["board"].state == "fault"
    assert found["board"].found.startswith("the check itself failed: ValueError")
    assert found["sensor"].state == "ok"


@pytest.mark.broker  # for its seconds of waiting
def test_a_driver_and_a_broker_that_hang_are_left(config: Path, machine: Any) -> None:
    """A pipe without a writer hangs whoever opens it, as a broken driver does; where a file should be it is told."""
    pipe = config.with_name("pipe")
    os.mkfifo(pipe)
    machine.put("/sys/devices/platform/soc/soc:firmware/get_throttled", "")
    driver = machine.at("/sys/devices/platform/soc/soc:firmware/get_throttled")
    driver.unlink()
    os.mkfifo(driver)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        config.write_text(
            f"calibration: pipe\nmqtt: {{host: 127.0.0.1, port: {silent.getsockname()[1]}}}\n"
            "source: {kind: simulated}\n"
        )
        began_s = time.monotonic()
        found = checked(config, machine)
        took_s = time.monotonic() - began_s
    assert "does not answer" in found["broker"].found
    assert (found["board"].state, found["board"].found) == ("fault", "no answer in time")
    assert "pipe: cannot read the calibration: found no regular file" in found["calibration"].found
    assert took_s < stretched(20)
    os.close(os.open(driver, os.O_RDWR | os.O_NONBLOCK))


def test_the_limits_keep_the_promise() -> None:
    assert MACHINE_S + NODE_S + CAPTURE_S + JUDGE_S < 20
