"""Requests to the daemon in this process, and the reference that they take or that follows by itself."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.running_app import (
    BASE,
    Running,
    ask,
    document,
    last,
    paced,
    states,
)

from tacshade_edge.daemon import references as untouched
from tacshade_edge.protocol import wire
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


def test_requests(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    touch = threading.Event()

    def stream() -> Iterator[Any]:
        pause = threading.Event()
        while True:
            yield pictures.touched if touch.is_set() else pictures.free
            yield lambda: pause.wait(0.02)

    app = Running(document(tmp_path, broker.port), scripted(stream()), calibration)
    try:
        wait_until(lambda: "online" in states(seen) and seen.of(f"{BASE}/health"), 10, "online")
        status = ask(seen, "status")
        assert status["ok"] is True
        assert status["result"]["source"] == "streaming"
        assert status["result"]["health"]["frames"]["captured"] >= 0

        assert ask(seen, "profile", profile="paper") == {"ok": True, "result": {"profile": "paper"}}
        wait_until(lambda: last(seen, "info")["profile"] == "paper", 5, "info tells the profile")
        refused = ask(seen, "profile", profile="slow")
        assert refused == {
            "ok": False,
            "error": "profile: found slow, expected one of paper, fast, balanced, accurate",
            "reason_code": "unknown_profile",
        }
        ask(seen, "profile", profile="fast")
        refused = ask(seen, "stitch", action="begin")
        assert refused["error"].startswith("UNAVAILABLE: found no source of poses, expected `serial` in the settings")

        taken = ask(seen, "reference")
        assert taken["ok"] is True, taken
        assert taken["result"]["frames"] == 10
        crc = taken["result"]["calibration_crc32"]
        wait_until(lambda: last(seen, "info")["geometry"]["calibration_crc32"] == crc, 5, "info tells the reference")
        touch.set()
        heights = seen.wait_for(f"{BASE}/height", len(seen.of(f"{BASE}/height")) + 1, 5)
        assert wire.decode(heights[-1]).calibration_crc32 == crc
        refused = ask(seen, "reference")
        assert refused["ok"] is False
        assert "found a contact" in refused["error"]
    finally:
        app.end()


def test_a_requested_reference_outlives_a_restart_and_a_reload(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    calibration_file.save(tmp_path / "cal.npz", calibration)
    settings = document(tmp_path, broker.port, "calibration: cal.npz\n")
    darker = np.asarray(pictures.free * 0.8, np.uint8)

    def told() -> tuple[str, int]:
        info = last(seen, "info")
        return info["reference"]["origin"], info["geometry"]["calibration_crc32"]

    app = Running(settings, scripted(paced(darker)), calibration)
    try:
        wait_until(lambda: last(seen, "status/camera").get("state") == "streaming", 10, "streaming")
        assert told() == ("calibration", calibration.crc32)
        taken = ask(seen, "reference")["result"]
        assert taken["stored"] is True
        crc = taken["calibration_crc32"]
        wait_until(lambda: told() == ("request", crc), 5, "info tells the reference")
        before = len(seen.of(f"{BASE}/info"))
        app.app.reload()
        seen.wait_for(f"{BASE}/info", before + 1, 5)
        assert told() == ("request", crc)
    finally:
        app.end()
    before = len(seen.of(f"{BASE}/info"))
    app = Running(settings, scripted(paced(darker)), calibration)
    try:
        seen.wait_for(f"{BASE}/info", before + 1, 10)
        assert told() == ("request", crc)
        other = replace(calibration, reference_grey=np.asarray(calibration.reference_grey // 2, np.uint8))
        newer = calibration_file.save(tmp_path / "cal.npz", other)
        app.app.reload()
        wait_until(lambda: told() == ("calibration", newer.crc32), 5, "the new calibration's own")
        assert last(seen, "info")["reference"]["reason_code"] == "calibration_changed"
    finally:
        app.end()


def test_the_reference_follows_a_light_that_ages_but_not_in_a_recording(
    tmp_path: Path,
    broker: Broker,
    seen: Subscriber,
    calibration: Calibration,
    pictures: Any,
    scripted: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(untouched, "REST_S", 0.2)
    monkeypatch.setattr(untouched, "PERIOD_S", 0.2)
    age = threading.Event()

    def ageing() -> Iterator[Any]:
        while True:
            yield from paced(np.asarray(pictures.free * (0.9 if age.is_set() else 1.0), np.uint8), 2)

    def told() -> dict[str, Any]:
        reference: dict[str, Any] = last(seen, "health").get("reference", {})
        return reference

    app = Running(document(tmp_path, broker.port), scripted(ageing()), calibration)
    try:
        wait_until(lambda: told().get("looks", 0) > 1, 10, "looks")
        assert (told()["state"], told()["renewals"]) == ("following", 0)
        assert ask(seen, "record", action="start", seconds=600, name="one")["ok"]
        age.set()
        wait_until(lambda: told()["state"] == "held", 10, "held")
        assert last(seen, "info")["geometry"]["calibration_crc32"] == calibration.crc32
        ask(seen, "record", action="stop")
        wait_until(lambda: told()["renewals"] == 1, 10, "a renewal")
        assert told()["light"] == pytest.approx(0.9, abs=0.03)
        info = last(seen, "info")
        assert info["geometry"]["calibration_crc32"] != calibration.crc32
        assert info["reference"]["calibration_crc32"] == calibration.crc32
    finally:
        app.end()
