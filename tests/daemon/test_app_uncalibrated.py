"""The daemon before there is a calibration: the camera's picture, and what to do; then the calibration comes."""

from __future__ import annotations

import itertools
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tacshade_edge.daemon.app import App, reload
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import calibrations
from tacshade_edge.protocol import wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import load
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import patience, wait_until
from tools.testbed.robot import PtyRobot

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]
BASE = "tacshade/tacshade"
CODE = "not_calibrated"


def stream(pictures: Any, touched: threading.Event) -> Iterator[Any]:
    pause = threading.Event()
    while True:
        yield pictures.touched if touched.is_set() else pictures.free
        yield lambda: pause.wait(0.02)


def test_the_picture_until_a_calibration_comes(
    tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    link, path, touched = Path(f"/dev/shm/tacshade-raw-{os.getpid()}"), tmp_path / "settings.yaml", threading.Event()
    with (
        Broker(tmp_path) as broker,
        Subscriber(broker.port) as seen,
        PtyRobot(link, rate_hz=20, binary=True) as robot,
    ):
        path.write_text(
            "calibration: c.npz\nsource: {kind: simulated}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}, home_assistant: true}}\n"
            f"serial: {{device: {link}}}\nstitching: {{folder: sessions}}\n"
        )
        document = load(path)
        missing = calibrations.find_calibration(document)
        assert isinstance(missing, Reason)
        app = App(document, scripted(stream(pictures, touched)), missing)
        thread = threading.Thread(target=app.run)
        thread.start()
        numbers = itertools.count()

        def last(topic: str) -> Any:
            payloads = seen.of(f"{BASE}/{topic}")
            return json.loads(payloads[-1]) if payloads else {}

        def ask(verb: str, **body: Any) -> Any:
            transaction = next(numbers)
            seen.publish(f"{BASE}/req/{verb}", json.dumps({"transaction": transaction, **body}).encode())
            wait_until(lambda: last(f"res/{verb}").get("transaction") == transaction, 10, f"an answer to {verb}")
            return last(f"res/{verb}")

        try:
            picture = cv2.imdecode(np.frombuffer(seen.wait_for(f"{BASE}/preview", 1, 10)[0], np.uint8), 0)
            assert picture.shape == (240, 320)
            wait_until(lambda: last("status/camera").get("state") == "unusable", 10, "told")
            told = last("status/camera")
            assert (told["reason_code"], told["script"]) == (CODE, "test")
            assert f"not calibrated: found no file {tmp_path}/c.npz" in told["reason"]
            assert f"tacshade-edge capture DIR --config {path}" in told["reason"]
            assert f"--out {tmp_path}/c.npz" in told["reason"]
            seen.wait_for_last(f"{BASE}/state", b"degraded")
            assert json.loads(seen.wait_for("homeassistant/button/tacshade/rezero/config")[0])["name"] == "Re-zero"
            info = last("info")
            assert (info["geometry"], info["reference"], info["reason_code"]) == (None, None, CODE)
            assert info["reason"] == told["reason"]
            assert last("contact")["reason_code"] == CODE
            wait_until(lambda: last("health").get("frames", {}).get("invalid", 0) > 0, 10, "frames are counted")
            assert last("health")["invalid_reason_code"] == CODE

            for verb, body in {
                "reference": {},
                "profile": {"profile": "fast"},
                "record": {"action": "start", "seconds": 1},
                "stitch": {"action": "begin"},
            }.items():
                assert ask(verb, **body)["reason_code"] == CODE
            status = ask("status")
            assert (status["ok"], status["result"]["reason_code"]) == (True, CODE)
            for line in ("CAPTURE", "REFERENCE", "STITCH BEGIN pad", "STITCH STATUS"):
                before = set(robot.replies)
                robot.ask(line)

                def refused(before: set[int] = before) -> bool:
                    new = [reply for number, reply in robot.replies.items() if number not in before]
                    return any(" UNCALIBRATED not calibrated: found no file" in reply for reply in new)

                wait_until(refused, 10, line)

            (tmp_path / "c.npz").write_bytes(b"nothing of the kind")
            wait_until(lambda: "not a calibration" in last("status/camera")["reason"] + last("info")["reason"], 10)
            assert last("status/camera")["reason_code"] == CODE
            calibration_file.save(tmp_path / "c.npz", calibration)
            wait_until(lambda: seen.of(f"{BASE}/state")[-1] == b"online", 10, "calibrated")
            assert last("status/camera")["state"] == "streaming"
            assert last("info")["geometry"]["calibration_crc32"] == calibration_file.load(tmp_path / "c.npz").crc32
            assert last("info")["reason"] == ""
            assert not seen.of(f"{BASE}/height")
            touched.set()
            assert wire.decode(seen.wait_for(f"{BASE}/height", 1, 10)[0]).contact
            assert ask("profile", profile="fast")["ok"]
        finally:
            app.stop()
            thread.join(patience(10))
        assert not thread.is_alive()
        wait_until(lambda: seen.of(f"{BASE}/state")[-1] == b"stopped", 5, "stopped")
    link.unlink(missing_ok=True)


def test_a_reload_takes_settings_over_while_the_calibration_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("calibration: c.npz\nsource: {kind: simulated}\n")
    document = load(path)
    path.write_text("calibration: d.npz\nprofile: fast\nsource: {kind: simulated}\n")
    new = reload(document, calibrated=False)
    assert isinstance(new.calibration, Reason)
    assert (new.calibration.code, new.document.settings.profile) == (ReasonCode.NOT_CALIBRATED, "fast")
    with pytest.raises(ConfigError, match="cannot read the calibration: No such file"):
        reload(document, calibrated=True)
