"""The daemon in this process while its camera or its broker is gone, hangs, or shows nothing of use."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.running_app import (
    BASE,
    GONE,
    NO_REASON,
    STOP_S,
    Running,
    assert_accounted,
    document,
    last,
    paced,
    states,
)

from tacshade_edge.protocol import wire
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber, free_port
from tools.testbed.patience import stretched, wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


def test_a_lost_camera_degrades_and_a_new_one_brings_the_stream_back(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    source = scripted([*paced(pictures.free, 10), GONE], GONE, GONE, paced(pictures.touched))
    app = Running(document(tmp_path, broker.port), source, calibration)
    try:
        seen.wait_for(f"{BASE}/height", 5, 10)
        wait_until(lambda: states(seen)[-1:] == ["online"], 5, "online again")
    finally:
        took_s = app.end()
    assert took_s < stretched(STOP_S)
    wait_until(lambda: states(seen)[-1:] == ["stopped"], 5, "stopped")
    assert states(seen)[-3:-1] == ["degraded", "online"]
    cameras = [json.loads(p) for p in seen.of(f"{BASE}/status/camera")]
    assert {"state": "away", "reason": str(GONE), "reason_code": "device"} in cameras
    assert {"state": "streaming", **NO_REASON, "script": "test"} in cameras
    assert_accounted(last(seen, "health")["frames"])


def test_a_stop_is_quick_while_the_camera_hangs(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    release = threading.Event()
    app = Running(document(tmp_path, broker.port), scripted([pictures.free, release.wait, None]), calibration)
    try:
        wait_until(
            lambda: "online" in states(seen) and last(seen, "status/camera").get("state") == "streaming", 10, "online"
        )
        assert app.end() < stretched(STOP_S)
        wait_until(lambda: states(seen)[-1] == "stopped", 5, "stopped")
        assert_accounted(last(seen, "health")["frames"])
    finally:
        release.set()


def test_a_silent_camera_degrades_after_the_stall_time(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    release = threading.Event()
    script = [pictures.free, release.wait, *paced(pictures.free, 20), None]
    app = Running(document(tmp_path, broker.port), scripted(script), calibration)
    wait_until(lambda: last(seen, "status/camera").get("state") == "streaming", 10, "streaming")
    wait_until(lambda: last(seen, "status/camera")["reason_code"] == "stalled", 10, "stalled")
    wait_until(lambda: states(seen)[-1] == "degraded", 10, "degraded")
    release.set()
    app.join()
    wait_until(lambda: states(seen)[-1] == "stopped", 5, "stopped")
    assert "online" in states(seen)[states(seen).index("degraded") :]


def test_a_stop_is_quick_without_a_broker_and_while_it_hangs(
    tmp_path: Path, broker: Broker, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    absent = Running(document(tmp_path, free_port()), scripted(paced(pictures.touched)), calibration)
    ledger = absent.app.ledger
    wait_until(lambda: ledger.counts().captured > 20, 10, "frames without a broker")
    assert absent.end() < stretched(STOP_S)
    assert_accounted(ledger.counts().as_dict())
    assert ledger.counts().published == 0

    stalled = Running(document(tmp_path, broker.port), scripted(paced(pictures.touched)), calibration)
    ledger = stalled.app.ledger
    wait_until(lambda: ledger.counts().unasked > 5, 10, "frames that nobody at the broker asks for")
    broker.stall()
    try:
        assert stalled.end() < stretched(STOP_S)
    finally:
        broker.resume()
    assert_accounted(ledger.counts().as_dict())


def test_a_broker_that_comes_late_and_restarts_gets_the_stream_without_help(
    tmp_path: Path, broker: Broker, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    broker.stop()
    app = Running(document(tmp_path, broker.port), scripted(paced(pictures.touched)), calibration)
    ledger = app.app.ledger
    try:
        wait_until(lambda: ledger.counts().failed > 5, 10, "frames that could not be sent")
        for _ in range(2):
            broker.start()
            with Subscriber(broker.port) as seen:
                first, *_, latest = (wire.decode(p) for p in seen.wait_for(f"{BASE}/height", 5, 10))
                assert latest.seq > first.seq
                seen.wait_for_last(f"{BASE}/state", b"online")
                seen.wait_for(f"{BASE}/info")
                assert last(seen, "info")["geometry"]["calibration_crc32"] == calibration.crc32
            broker.stop()
        counts = ledger.counts()
        assert counts.pending <= 6  # one in the mailbox, one in work, and the link's slot and two unsent
    finally:
        assert app.end() < stretched(STOP_S)
    assert_accounted(ledger.counts().as_dict())


def test_nothing_but_invalid_frames_is_a_degraded_state(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    dark, free = threading.Event(), threading.Event()

    def script() -> Iterator[Any]:
        for picture, until in ((pictures.free, dark), (pictures.black, free)):
            while not until.is_set():
                yield from paced(picture, 5)
        yield from paced(pictures.free)

    app = Running(document(tmp_path, broker.port), scripted(script()), calibration)
    try:
        wait_until(lambda: states(seen)[-1:] == ["online"], 10, "online")
        dark.set()
        wait_until(lambda: states(seen)[-1:] == ["degraded"], 10, "degraded")
        camera = last(seen, "status/camera")
        assert camera["state"] == "unusable"
        assert camera["reason"].startswith("black")
        free.set()
        wait_until(lambda: states(seen)[-1:] == ["online"], 10, "online again")
        assert last(seen, "status/camera")["state"] == "streaming"
    finally:
        app.end()
