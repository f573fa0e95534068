"""The daemon in this process: real threads, a real broker, a scripted camera."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from support.running_app import (
    BASE,
    GONE,
    Running,
    assert_accounted,
    document,
    last,
    paced,
    states,
)

from tacshade_edge.core.profiles import DEFAULT
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.protocol import wire
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.painted_sensor import touched_depth_mm
from tools.testbed.patience import wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


def test_from_frames_to_a_subscriber_with_every_frame_accounted_for(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    script = [
        *paced(pictures.free, 20),
        *paced(pictures.touched, 20),
        DecodeError("torn"),
        *paced(pictures.free, 10),
        *paced(pictures.black, 5),
        *paced(pictures.touched, 3),
        None,
    ]
    wall_before = time.time_ns()
    app = Running(document(tmp_path, broker.port), scripted(paced_start(seen), [*script]), calibration)
    app.join()
    assert app.error is None
    wait_until(lambda: states(seen)[-1:] == ["stopped"], 5, "stopped")
    wait_until(lambda: last(seen, "health").get("frames", {}).get("captured") == 59, 5, "the last health")

    frames = last(seen, "health")["frames"]
    assert_accounted(frames)
    assert (frames["captured"], frames["failed"]) == (59, 1)
    heights = [wire.decode(p) for p in seen.of(f"{BASE}/height")]
    assert len(heights) == frames["published"]
    assert [h.seq for h in heights] == sorted({h.seq for h in heights})
    deepest = max(float(np.nanmax(h.height_mm)) for h in heights if isinstance(h, wire.HeightMessage))
    assert deepest == pytest.approx(touched_depth_mm(), abs=0.001)
    released = [h for h in heights if not h.contact]
    assert [h.invalid for h in released] == [False]
    assert heights[0].calibration_crc32 == calibration.crc32
    assert wall_before < heights[0].wall_ns < time.time_ns()
    clouds = [wire.decode(p) for p in seen.of(f"{BASE}/cloud")]
    assert clouds
    assert all(c.contact for c in clouds)
    contacts = [json.loads(p) for p in seen.of(f"{BASE}/contact")]
    assert {c["contact"] for c in contacts} == {0, 1}
    info = last(seen, "info")
    assert (info["profile"], info["geometry"]["calibration_crc32"]) == (DEFAULT, calibration.crc32)
    health = last(seen, "health")
    assert health["latency_ms"]["p50"] > 0
    assert {"wait", "check", "grey", "gate", "deliver"} <= set(health["stages_ms"])
    preview = cv2.imdecode(np.frombuffer(seen.of(f"{BASE}/preview")[0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert preview.shape[:2] == (240, 320)


def paced_start(seen: Subscriber) -> list[Any]:
    """An opening that waits until the daemon is connected, so that nothing is lost, then fails once."""

    def connected() -> None:
        wait_until(lambda: seen.of(f"{BASE}/info"), 10, "info")

    return [connected, GONE]


def test_frames_that_the_access_rules_deny_are_none_that_were_published(
    tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    """The rules as shipped: a user may write below the sensor_id of its own name only."""
    rules, password = tmp_path / "acl", tmp_path / "password"
    for path in (rules, password):
        path.touch(0o600)
    rules.write_text((Path(__file__).parents[2] / "systemd/mosquitto-tacshade.acl").read_text())
    password.write_text("right\n")
    with Broker(tmp_path, users={"left": "right"}, more=(f"acl_file {rules}",)) as broker:
        settings = document(tmp_path, broker.port)
        denied = msgspec.structs.replace(settings.settings.mqtt, username="left", password_file=str(password))
        settings = replace(settings, settings=msgspec.structs.replace(settings.settings, mqtt=denied))
        app = Running(settings, scripted(paced(pictures.touched)), calibration)
        wait_until(lambda: app.app.ledger.counts().failed > 5, 20, "frames that were refused")
        app.end()
    assert app.app.link.counters()["refused"] > 5
    frames = app.app.ledger.counts().as_dict()
    assert_accounted(frames)
    assert frames["published"] == 0


def test_a_broker_that_takes_small_messages_only_is_a_degraded_state(
    tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    with Broker(tmp_path, more=("message_size_limit 4000",)) as broker, Subscriber(broker.port, f"{BASE}/#") as heard:
        app = Running(document(tmp_path, broker.port), scripted(paced(pictures.touched)), calibration)
        try:
            wait_until(lambda: last(heard, "status/broker").get("state") == "limited", 20, "the reason")
            assert last(heard, "status/broker")["reason_code"] == "message_size_limit"
            wait_until(lambda: states(heard)[-1:] == ["degraded"], 10, "degraded")
            wait_until(lambda: app.app.ledger.counts().failed > 0, 20, "frames that were refused")
        finally:
            app.end()
        assert heard.of(f"{BASE}/contact")
        assert not heard.of(f"{BASE}/height")
    counters = app.app.link.counters()
    assert counters["losses"] == 0
    assert counters["refused"] > 0
    assert_accounted(app.app.ledger.counts().as_dict())


def test_what_nobody_subscribes_to_is_not_computed_until_someone_does(
    tmp_path: Path, broker: Broker, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    app = Running(document(tmp_path, broker.port), scripted(paced(pictures.touched)), calibration)
    counts = app.app.ledger.counts
    try:
        wait_until(lambda: counts().unasked > 50, 20, "frames that nobody asks for")
        alone = counts()
        assert alone.published < alone.unasked / 3
        with Subscriber(broker.port, f"{BASE}/#") as seen:
            seqs = [wire.decode(p).seq for p in seen.wait_for(f"{BASE}/height", 20, 10)]
            assert seqs == sorted(set(seqs))
            seen.wait_for(f"{BASE}/cloud", 20)
            seen.wait_for(f"{BASE}/contact", 20)
            seen.wait_for(f"{BASE}/preview", 3)
            assert last(seen, "health")["frames"]["unasked"] >= alone.unasked
        before = counts().unasked
        wait_until(lambda: counts().unasked > before + 50, 20, "unasked again")
    finally:
        app.end()
    assert_accounted(counts().as_dict())


def test_a_source_that_can_never_work_ends_the_daemon(
    tmp_path: Path, broker: Broker, calibration: Calibration, scripted: Any
) -> None:
    app = Running(document(tmp_path, broker.port), scripted(ConfigError("x: found nothing")), calibration)
    app.join()
    assert str(app.error) == "x: found nothing"
    app.app.link.stop(1)
