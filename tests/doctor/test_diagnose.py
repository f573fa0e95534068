from __future__ import annotations

import json
import threading
import time
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.findings import checked
from support.mqtt_rig import free_port
from support.painted_sensor import FREE, painted_calibration
from support.patience import patience
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.doctor import Finding, fault, ok
from tacshade_edge.doctor.broker_check import DaemonState
from tacshade_edge.doctor.bundle import Seen, write_bundle
from tacshade_edge.doctor.camera_check import Captured
from tacshade_edge.doctor.diagnose import check_settings, diagnose, start, wait_for
from tacshade_edge.errors import DeviceError
from tacshade_edge.settings import Document, load


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


def by_check(config: Path, machine: Any) -> dict[str, Finding]:
    return {finding.check: finding for finding in checked(diagnose(config, machine))}


def test_every_subject_is_checked_whatever_another_says(config: Path, machine: Any) -> None:
    found = by_check(config, machine)
    assert {
        "settings",
        "broker",
        "serial",
        "disk",
        "clock",
        "source",
        "picture",
        "calibration",
        "sensor",
    } <= set(found)
    assert found["settings"].state == "ok"
    assert found["broker"].state == "fault"
    assert "daemon" not in found, "nobody to ask"
    assert found["sensor"].state == "ok"


def test_the_cameras_of_all_sensors_are_counted_on_usb(config: Path, machine: Any) -> None:
    size = "width_px: 640, height_px: 480"
    own = f"source: {{kind: v4l2, fourcc: YUYV, {size}, device: /dev/video90%d}}"
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


def test_without_the_camera_the_calibration_is_read_and_a_check_that_breaks_is_one_fault(
    config: Path, machine: Any
) -> None:
    config.write_text("calibration: c.npz\nsource: {kind: v4l2, width_px: 160, height_px: 120}\n")
    machine.put("/sys/devices/platform/soc/soc:firmware/get_throttled", "not a number")
    found = by_check(config, machine)
    assert (found["camera"].state, found["calibration"].state) == ("fault", "ok")
    assert "sensor" not in found
    assert "ValueError" in found["board"].found


@pytest.mark.parametrize(
    ("text", "state", "place", "usable", "broker"),
    [
        ("sensor_id: left\n", "ok", ", sensor left", True, True),
        ("sensor: a\n", "fault", ":1: sensor: ", False, False),
        (
            "source: {kind: simulated}\nmqtt: {ca_file: no.pem}\n",
            "fault",
            ":2: mqtt.ca_file: ",
            True,
            False,
        ),
        (
            "mqtt: {username: a, password_file: none}\n",
            "fault",
            ":1: mqtt.password_file: ",
            True,
            False,
        ),
        (None, "fault", "", False, False),
    ],
)
def test_settings(
    tmp_path: Path, text: str | None, state: str, place: str, usable: bool, broker: bool
) -> None:
    config = tmp_path / "s.yaml"
    if text is not None:
        config.write_text(text)
    finding, document, broker_usable = check_settings(config)
    checked([finding])
    assert finding.state == state
    assert finding.found.startswith(f"{config}{place}")
    assert (document is not None, broker_usable) == (usable, broker)


def test_a_check_that_hangs_is_left_behind_and_one_that_breaks_is_reported() -> None:
    release = threading.Event()
    began_s = time.monotonic()
    hung = start(lambda: (ok("hung", str(release.wait(60))),))
    quick, broken = start(lambda: (ok("quick", ""),)), start(lambda: (ok("broken", str(1 // 0)),))
    assert wait_for(hung, "hung", "wait", began_s + 0.05) == (
        fault("hung", "no answer in time", "wait"),
    )
    assert wait_for(quick, "quick", "", time.monotonic() + 10)[0].state == "ok"
    assert "ZeroDivisionError" in wait_for(broken, "broken", "", time.monotonic() + 10)[0].found
    assert time.monotonic() - began_s < patience(10)
    release.set()


SEEN = Captured(images=(FREE,))
FINDINGS = (
    ok("clock", "right"),
    fault("broker", "refuses the user bob or the password", "in /home/bob/pw"),
)


@pytest.fixture
def document(tmp_path: Path) -> Document:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "pw").write_text("pa55word\n")
    mqtt = "mqtt: {host: hand.example, username: bob, password_file: pw}"
    (tmp_path / "s.yaml").write_text(f"sensor_id: left\ncalibration: c.npz\n{mqtt}\n")
    return load(tmp_path / "s.yaml")


def read(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


def test_all_that_helps_is_in_it_and_nothing_secret(document: Document, tmp_path: Path) -> None:
    published = {"state": b"online", "health": b'{"note": "pa55word of bob"}', "info": b"\xff"}
    seen = Seen(document, DaemonState(published=published), SEEN)
    write_bundle(tmp_path / "b.zip", FINDINGS, seen, with_frame=False)
    files = read(tmp_path / "b.zip")
    named = ("findings", "versions", "published", "calibration")
    assert set(files) == {*(f"{name}.json" for name in named), "log.txt", "settings.yaml"}
    everything = b"".join(files.values())
    for secret in (b"pa55word", b"bob", str(tmp_path / "pw").encode()):
        assert secret not in everything
    assert b"host: hand.example" in files["settings.yaml"]
    assert b"username: (left out)" in files["settings.yaml"]
    assert (
        json.loads(files["findings.json"])[1]["found"]
        == "refuses the user (left out) or the password"
    )
    assert json.loads(files["published.json"])["state"] == "online"
    assert json.loads(files["versions.json"])["packages"]["numpy"]
    facts = json.loads(files["calibration.json"])
    assert facts["crc32"] == f"{calibration_file.load(tmp_path / 'c.npz').crc32:08x}"


def test_a_frame_only_where_it_was_asked_for(document: Document, tmp_path: Path) -> None:
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(document, captured=SEEN), with_frame=True)
    image = cv2.imdecode(
        np.frombuffer(read(tmp_path / "b.zip")["frame.png"], np.uint8), cv2.IMREAD_UNCHANGED
    )
    np.testing.assert_array_equal(image, FREE)
    (tmp_path / "c.npz").unlink()
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(document), with_frame=True)
    files = read(tmp_path / "b.zip")
    assert "frame.png" not in files
    assert json.loads(files["calibration.json"])["reason"].startswith(str(tmp_path / "c.npz"))


def test_without_settings_and_where_it_cannot_be_written(tmp_path: Path) -> None:
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(), with_frame=True)
    assert "settings.yaml" not in read(tmp_path / "b.zip")
    with pytest.raises(DeviceError, match="cannot write it"):
        write_bundle(tmp_path / "none" / "b.zip", FINDINGS, Seen(), with_frame=False)
