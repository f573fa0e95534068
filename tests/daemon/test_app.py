"""The daemon in this process: real threads, a real broker, a scripted camera."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.mqtt_rig import Broker, Subscriber, free_port
from support.painted_sensor import touched_depth_mm
from support.patience import stretched, wait_until
from support.robot import PtyRobot
from support.running_app import (
    BASE,
    GONE,
    NO_REASON,
    STOP_S,
    Live,
    assert_accounted,
    paced,
    switched,
)
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.daemon.reloading import reload
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.profiles import DEFAULT
from tacshade_edge.settings import load
from tacshade_edge.types import Calibration, RestLimits
from tacshade_edge.wire import binary

pytestmark = pytest.mark.broker


def test_from_frames_to_a_subscriber_with_every_frame_accounted_for(
    live: Live, pictures: Any, scripted: Any
) -> None:
    def connected() -> None:
        wait_until(lambda: live.payloads("info"), 10, "info")

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
    # An opening that waits until the daemon is connected, so that nothing is lost, then fails once.
    app = live.run(scripted([connected, GONE], script))
    app.join()
    assert app.error is None
    live.until_state("stopped")
    wait_until(
        lambda: live.last("health").get("frames", {}).get("captured") == 59, 5, "the last health"
    )

    health = live.last("health")
    assert_accounted(health["frames"])
    assert health["frames"]["failed"] == 1
    heights = [binary.decode(p) for p in live.payloads("height")]
    assert len(heights) == health["frames"]["published"]
    assert [h.seq for h in heights] == sorted({h.seq for h in heights})
    deepest = max(
        float(np.nanmax(h.height_mm)) for h in heights if isinstance(h, binary.HeightMessage)
    )
    assert deepest == pytest.approx(touched_depth_mm(), abs=0.001)
    assert [h.invalid for h in heights if not h.contact] == [False]
    assert heights[0].calibration_crc32 == live.calibration.crc32
    assert wall_before < heights[0].wall_ns < time.time_ns()
    clouds = [binary.decode(p) for p in live.payloads("cloud")]
    assert clouds
    assert all(c.contact for c in clouds)
    assert {json.loads(p)["contact"] for p in live.payloads("contact")} == {0, 1, None}
    info = live.last("info")
    assert (info["profile"], info["geometry"]["calibration_crc32"]) == (
        DEFAULT,
        live.calibration.crc32,
    )
    assert health["latency_ms"]["p50"] > 0
    assert {"wait", "check", "grey", "gate", "deliver"} <= set(health["stages_ms"])
    preview = cv2.imdecode(
        np.frombuffer(live.payloads("preview")[0], np.uint8), cv2.IMREAD_UNCHANGED
    )
    assert preview.shape[:2] == (240, 320)


def test_a_touch_that_the_map_does_not_show_reaches_a_subscriber(live: Live, scripted: Any) -> None:
    limits = RestLimits(60, 1e-4, height_mm=0.001, local_change=0.9, changed_part=0.9)
    knows_rest = replace(calibrated(HALF, 0), rest={"fast": limits})
    faint, lifted = pressed("ball", 0.1, HALF, 2.0).image, threading.Event()

    def touch_and_lift() -> Iterator[Any]:
        yield from paced(unloaded(), 10)
        while not lifted.is_set():
            yield from paced(faint, 1)
        yield from paced(unloaded())

    with live.run(scripted(touch_and_lift()), "profile: fast\n", knows_rest):
        felt = live.until("contact", touched=1)
        assert (felt["contact"], felt["depth_max_mm"]) == (0, None)
        assert felt["degraded_code"] == "touch_unmeasured"
        assert live.until("event/contact", type="new")["depth_max_mm"] is None
        wait_until(lambda: live.last("health").get("touched_frames", 0) > 0, 15, "the count")
        lifted.set()
        live.until("contact", touched=0, contact=0, depth_max_mm=0.0)
        live.until("event/contact", type="end")
    heights = [binary.decode(payload) for payload in live.payloads("height")]
    assert [(each.contact, each.touched) for each in heights] == [(False, True), (False, False)]


def test_a_broker_that_takes_small_messages_only_is_a_degraded_state(
    tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    with (
        Broker(tmp_path, more=("message_size_limit 4000",)) as broker,
        Subscriber(broker.port, f"{BASE}/#") as heard,
    ):
        live = Live(tmp_path, broker, heard, calibration)
        with live.run(scripted(paced(pictures.touched))) as app:
            live.until(
                "status/broker", state="limited", reason_code="message_size_limit", seconds=20
            )
            live.until_state("degraded")
            wait_until(lambda: app.counts().failed > 0, 20, "frames that were refused")
        assert live.payloads("contact")
        assert not live.payloads("height")
    counters = app.app.link.counters()
    assert (counters["losses"], counters["refused"] > 0) == (0, True)
    assert_accounted(app.counts().as_dict())


def test_what_nobody_subscribes_to_is_not_computed_until_someone_does(
    tmp_path: Path, broker: Broker, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    live = Live(tmp_path, broker, Subscriber(broker.port), calibration)
    with live.run(scripted(paced(pictures.touched))) as app:
        wait_until(lambda: app.counts().unasked > 50, 20, "frames that nobody asks for")
        alone = app.counts()
        assert alone.published < alone.unasked / 3
        with Subscriber(broker.port, f"{BASE}/#") as seen:
            seqs = [binary.decode(p).seq for p in seen.wait_for(f"{BASE}/height", 20, 10)]
            assert seqs == sorted(set(seqs))
            for topic, count in (("cloud", 20), ("contact", 20), ("preview", 3), ("health", 1)):
                seen.wait_for(f"{BASE}/{topic}", count)
        before = app.counts().unasked
        wait_until(lambda: app.counts().unasked > before + 50, 20, "unasked again")
    assert_accounted(app.counts().as_dict())


def test_a_source_that_can_never_work_ends_the_daemon(live: Live, scripted: Any) -> None:
    app = live.run(scripted(ConfigError("x: found nothing")))
    app.join()
    assert str(app.error) == "x: found nothing"
    app.app.link.stop(1)


# While its camera or its broker is gone, hangs, or shows nothing of use.


def test_a_lost_camera_degrades_and_a_new_one_brings_the_stream_back(
    live: Live, pictures: Any, scripted: Any
) -> None:
    app = live.run(scripted([*paced(pictures.free, 10), GONE], GONE, GONE, paced(pictures.touched)))
    try:
        live.seen.wait_for(f"{BASE}/height", 5, 10)
        live.until_state("online")
    finally:
        took_s = app.end()
    assert took_s < stretched(STOP_S)
    live.until_state("stopped")
    assert live.states()[-3:-1] == ["degraded", "online"]
    cameras = [json.loads(p) for p in live.payloads("status/camera")]
    assert {"state": "away", "reason": str(GONE), "reason_code": "device"} in cameras
    assert {"state": "streaming", **NO_REASON, "script": "test"} in cameras
    assert_accounted(live.last("health")["frames"])


def test_a_camera_that_hangs_degrades_and_a_stop_is_quick(
    live: Live, pictures: Any, scripted: Any
) -> None:
    first, second = threading.Event(), threading.Event()
    script = [pictures.free, first.wait, *paced(pictures.free, 20), second.wait, None]
    app = live.run(scripted(script))
    try:
        live.until("status/camera", state="streaming")
        live.until("status/camera", reason_code="stalled")
        live.until_state("degraded")
        first.set()
        live.until_state("online")
        assert app.end() < stretched(STOP_S)
        live.until_state("stopped")
        assert_accounted(live.last("health")["frames"])
    finally:
        first.set()
        second.set()


def test_a_stop_is_quick_without_a_broker_and_while_it_hangs(
    live: Live, pictures: Any, scripted: Any
) -> None:
    document = live.document()
    away = msgspec.structs.replace(document.settings.mqtt, port=free_port())
    absent = live.run(
        scripted(paced(pictures.touched)),
        replace(document, settings=msgspec.structs.replace(document.settings, mqtt=away)),
    )
    wait_until(lambda: absent.counts().captured > 20, 10, "frames without a broker")
    assert absent.end() < stretched(STOP_S)
    assert_accounted(absent.counts().as_dict())
    assert absent.counts().published == 0

    stalled = live.run(scripted(paced(pictures.touched)))
    live.seen.wait_for(f"{BASE}/height", 5)
    live.broker.stall()
    try:
        assert stalled.end() < stretched(STOP_S)
    finally:
        live.broker.resume()
    assert_accounted(stalled.counts().as_dict())


def test_no_frame_comes_before_the_first_connection(
    live: Live, pictures: Any, scripted: Any
) -> None:
    """To ask for a name that the broker does not know takes a third of a second."""
    reasons: list[object] = []
    source = scripted(
        [lambda: reasons.append(app.app.link.reason), *paced(pictures.touched, 5), None]
    )
    app = live.run(source)
    app.join()
    assert reasons == [None]
    assert app.counts().superseded == 0


def test_a_broker_that_comes_late_and_restarts_gets_the_stream_without_help(
    tmp_path: Path, broker: Broker, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    broker.stop()
    app = Live(tmp_path, broker, Subscriber(broker.port), calibration).run(
        scripted(paced(pictures.touched))
    )
    try:
        wait_until(lambda: app.counts().superseded > 5, 10, "frames before the first broker")
        assert app.counts().failed == 0
        for _ in range(2):
            broker.start()
            with Subscriber(broker.port) as seen:
                first, *_, latest = (
                    binary.decode(p) for p in seen.wait_for(f"{BASE}/height", 5, 10)
                )
                assert latest.seq > first.seq
                seen.wait_for_last(f"{BASE}/state", b"online")
                info = json.loads(seen.wait_for(f"{BASE}/info")[-1])
                assert info["geometry"]["calibration_crc32"] == calibration.crc32
            broker.stop()
        assert (
            app.counts().pending <= 6
        )  # one in the mailbox, one in work, and the link's slot and two unsent
    finally:
        assert app.end() < stretched(STOP_S)
    assert_accounted(app.counts().as_dict())


def test_nothing_but_invalid_frames_is_a_degraded_state(
    live: Live, pictures: Any, scripted: Any
) -> None:
    dark, free = threading.Event(), threading.Event()

    def script() -> Iterator[Any]:
        for picture, until in ((pictures.free, dark), (pictures.black, free)):
            while not until.is_set():
                yield from paced(picture, 5)
        yield from paced(pictures.free)

    with live.run(scripted(script())):
        live.until_state("online")
        dark.set()
        live.until_state("degraded")
        camera = live.last("status/camera")
        assert (camera["state"], camera["reason_code"]) == ("unusable", "black")
        free.set()
        live.until_state("online")
        assert live.last("status/camera")["state"] == "streaming"


# Before there is a calibration: the camera's picture, and what to do; then the calibration comes.


def refuses_what_needs_a_calibration(live: Live, robot: PtyRobot, code: str) -> None:
    """Every request that needs a calibration is refused with the reason's code."""
    requests: dict[str, dict[str, Any]] = {"reference": {}, "profile": {"profile": "fast"}}
    requests |= {"record": {"action": "start", "seconds": 1}, "stitch": {"action": "begin"}}
    for verb, body in requests.items():
        assert live.ask(verb, **body)["reason_code"] == code
    status = live.ask("status")
    assert (status["ok"], status["result"]["reason_code"]) == (True, code)
    robot.ask("CAPTURE")
    wait_until(
        lambda: any(" UNCALIBRATED not calibrated: " in a for a in robot.answers), 10, "CAPTURE"
    )


def test_the_picture_until_a_calibration_comes(live: Live, pictures: Any, scripted: Any) -> None:
    link, code, touched = (
        Path(f"/dev/shm/tacshade-raw-{os.getpid()}"),
        "not_calibrated",
        threading.Event(),
    )
    settings = live.document(
        f"calibration: c.npz\nserial: {{device: {link}}}\nstitching: {{folder: sessions}}\n"
    )
    settings.path.write_text(
        settings.path.read_text().replace("mqtt: {", "mqtt: {home_assistant: true, ")
    )
    settings = load(settings.path)
    missing, calibration = loading.find_calibration(settings), live.folder / "c.npz"
    assert isinstance(missing, Reason)
    with (
        PtyRobot(link, rate_hz=20, binary=True) as robot,
        live.run(scripted(switched(pictures, touched)), settings, missing),
    ):
        picture = cv2.imdecode(
            np.frombuffer(live.seen.wait_for(f"{BASE}/preview", 1, 10)[0], np.uint8), 0
        )
        assert picture.shape == (240, 320)
        camera = live.until("status/camera", state="unusable")
        assert (camera["reason_code"], camera["script"]) == (code, "test")
        for text in (
            f"found no file {calibration}",
            f"capture DIR --config {settings.path}",
            f"--out {calibration}",
        ):
            assert text in camera["reason"]
        live.seen.wait_for_last(f"{BASE}/state", b"degraded")
        button = live.seen.wait_for("homeassistant/button/hand-1/rezero/config")[0]
        assert json.loads(button)["name"] == "Re-zero"
        info = live.last("info")
        assert (info["geometry"], info["reference"], info["reason_code"]) == (None, None, code)
        assert info["reason"] == camera["reason"]
        assert live.last("contact")["reason_code"] == code
        # The first of them may be counted before its reason is known.
        health = live.until("health", invalid_reason_code=code)
        assert health["frames"]["invalid"] > 0

        refuses_what_needs_a_calibration(live, robot, code)
        calibration.write_bytes(b"nothing of the kind")
        wait_until(
            lambda: (
                "expected a calibration written by"
                in live.last("status/camera")["reason"] + live.last("info")["reason"]
            ),
            10,
        )
        assert live.last("status/camera")["reason_code"] == code
        calibration_file.save(calibration, live.calibration)
        live.until_state("online")
        assert live.last("status/camera")["state"] == "streaming"
        info = live.last("info")
        assert (info["geometry"]["calibration_crc32"], info["reason"]) == (
            calibration_file.load(calibration).crc32,
            "",
        )
        assert not live.payloads("height")
        touched.set()
        assert binary.decode(live.seen.wait_for(f"{BASE}/height", 1, 10)[0]).contact
        assert live.ask("profile", profile="fast")["ok"]
    live.until_state("stopped")
    link.unlink(missing_ok=True)


def test_a_reload_takes_settings_over_while_the_calibration_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("calibration: c.npz\nsource: {kind: simulated}\n")
    running = load(path)
    path.write_text("calibration: d.npz\nprofile: fast\nsource: {kind: simulated}\n")
    document, calibration, _ = reload(running, calibrated=False)
    assert isinstance(calibration, Reason)
    assert (calibration.code, document.settings.profile) == (ReasonCode.NOT_CALIBRATED, "fast")
    with pytest.raises(ConfigError, match="cannot read the calibration: No such file"):
        reload(running, calibrated=True)
