"""The daemon in this process: real threads, a real broker, a scripted camera."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from support.mqtt_rig import MOSQUITTO, Broker, Subscriber, free_port
from support.painted_sensor import touched_depth_mm
from support.patience import patience, stretched, wait_until

from tacshade_edge.core.profiles import DEFAULT, LADDER, PROFILES
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.profiles import profile_chooser
from tacshade_edge.daemon.reference import untouched
from tacshade_edge.devices.files import calibration_file
from tacshade_edge.devices.files.frame_table import read_table
from tacshade_edge.devices.files.recording import Recording
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.protocol import wire
from tacshade_edge.settings import Document, load
from tacshade_edge.types import U8, Calibration

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]
BASE = "tacshade/hand-1"
NO_REASON = {"reason": "", "reason_code": ""}
GONE = DeviceError("camera /dev/video9: gone")
STOP_S = 2.0


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path) as started:
        yield started


@pytest.fixture
def seen(broker: Broker) -> Iterator[Subscriber]:
    with Subscriber(broker.port) as subscriber:
        yield subscriber


def paced(image: U8, frames: int | None = None, period_s: float = 0.02) -> Iterator[Any]:
    """`frames` (None: for ever) of one picture at 50 per second."""
    pause = threading.Event()
    sent = 0
    while frames is None or sent < frames:
        yield image
        yield lambda: pause.wait(period_s)
        sent += 1


def document(folder: Path, port: int, more: str = "") -> Document:
    path = folder / "settings.yaml"
    if "calibration:" not in more:  # never the machine's own
        more += "calibration: calibration.npz\n"
    path.write_text(
        f"sensor_id: hand-1\nsource: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
        f"recorder: {{folder: recs}}\n{more}",
        encoding="utf-8",
    )
    return load(path)


class Running:
    """An app in a thread of its own; `end` stops it and tells how long that took."""

    def __init__(self, settings: Document, source: Any, calibration: Calibration) -> None:
        self.app = App(settings, source, calibration)
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.app.run()
        except (ConfigError, ZeroDivisionError) as error:
            self.error = error

    def end(self) -> float:
        began = time.monotonic()
        self.app.stop()
        return self.join() - began

    def join(self) -> float:
        self._thread.join(patience(20))
        assert not self._thread.is_alive()
        return time.monotonic()


def states(seen: Subscriber) -> list[str]:
    return [payload.decode() for payload in seen.of(f"{BASE}/state")]


def last(seen: Subscriber, topic: str) -> Any:
    payloads = seen.of(f"{BASE}/{topic}")
    return json.loads(payloads[-1]) if payloads else {}


def assert_accounted(frames: dict[str, int]) -> None:
    assert frames["pending"] == 0
    parts = ("published", "superseded", "without_contact", "unasked", "invalid", "failed")
    assert frames["captured"] == sum(frames[name] for name in parts)


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
        wait_until(lambda: app.app.link.counters()["refused"] > 20, 20, "refused")
        app.end()
    frames = app.app.ledger.counts().as_dict()
    assert_accounted(frames)
    assert frames["published"] == 0
    assert frames["failed"] > 5


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


def ask(seen: Subscriber, verb: str, **body: Any) -> Any:
    """The reply to one request."""
    topic = f"{BASE}/res/{verb}"
    before = len(seen.of(topic))
    seen.publish(f"{BASE}/req/{verb}", json.dumps({"transaction": f"t{before}", **body}).encode())
    answer = json.loads(seen.wait_for(topic, before + 1, 10)[-1])
    assert answer.pop("transaction") == f"t{before}"
    return answer


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
        assert refused["error"].startswith("UNAVAILABLE: found no poses, expected `serial` in the settings")

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
        assert "shows contact" in refused["error"]
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


class Late:
    """A source whose frames are so many ms old when they come, as those of a machine that has other work."""

    def __init__(self, source: Any) -> None:
        self._source = source
        self.ms = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def read(self) -> Any:
        frame = self._source.read()
        return frame and replace(frame, t_ns=frame.t_ns - self.ms * 1_000_000)


def test_auto_steps_down_under_a_load_and_up_after_it_and_says_so(
    tmp_path: Path,
    broker: Broker,
    seen: Subscriber,
    calibration: Calibration,
    pictures: Any,
    scripted: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(profile_chooser, "PATIENCE_S", 0.2)
    budget_ms = 1000  # of a test's machine, which has other work too
    settings = document(tmp_path, broker.port, f"profile: auto\nlatency_budget_ms: {budget_ms}\n")
    source = Late(scripted(paced(pictures.touched)))
    app = Running(settings, source, calibration)
    ladder = list(LADDER)

    def told_profiles() -> list[str]:
        return [json.loads(payload)["profile"] for payload in seen.of(f"{BASE}/info")]

    def budget() -> Any:
        return last(seen, "health").get("budget") or {}

    try:
        wait_until(lambda: budget().get("kept"), 20, "the budget is kept")
        info = last(seen, "info")
        assert (info["choice"], info["profile"], info["profiles"]) == ("auto", ladder[0], [*PROFILES, "auto"])
        assert budget()["p90_ms"] <= budget_ms == budget()["latency_budget_ms"]

        source.ms = 5 * budget_ms
        wait_until(lambda: told_profiles()[-1] == ladder[-1], 20, "stepped down")
        wait_until(lambda: budget().get("kept") is False, 20, "health says that it is not kept")
        assert (budget()["profile"], budget()["steps_down"], budget()["steps_up"]) == (ladder[-1], len(ladder) - 1, 0)
        assert budget()["p90_ms"] > budget_ms

        source.ms = 0
        wait_until(lambda: told_profiles()[-1] == ladder[0], 30, "stepped up")
        wait_until(lambda: budget().get("kept"), 20, "kept again")
        assert budget()["steps_up"] == len(ladder) - 1
        told = [profile for profile, _ in groupby(told_profiles())]
        assert told == ladder + ladder[-2::-1]
        assert all(json.loads(payload)["choice"] == "auto" for payload in seen.of(f"{BASE}/info"))

        assert ask(seen, "profile", profile="fast")["result"] == {"profile": "fast"}
        wait_until(lambda: last(seen, "info")["choice"] == "fast", 10, "auto is over")
        wait_until(lambda: last(seen, "health")["budget"] is None, 10, "and no budget told")
        assert ask(seen, "profile", profile="auto")["result"] == {"profile": ladder[0]}
        wait_until(lambda: last(seen, "info")["choice"] == "auto", 10, "auto again")
    finally:
        app.end()
    wait_until(lambda: states(seen)[-1:] == ["stopped"], 5, "stopped")
    assert_accounted(last(seen, "health")["frames"])
    heights = [wire.decode(payload).seq for payload in seen.of(f"{BASE}/height")]
    assert heights == sorted(set(heights))
    steps = [record for record in caplog.records if record.getMessage().startswith("profile auto: from ")]
    assert len(steps) == 2 * (len(ladder) - 1)
    assert all(record.levelno == logging.INFO for record in steps)


def test_a_source_that_can_never_work_ends_the_daemon(
    tmp_path: Path, broker: Broker, calibration: Calibration, scripted: Any
) -> None:
    app = Running(document(tmp_path, broker.port), scripted(ConfigError("x: found nothing")), calibration)
    app.join()
    assert str(app.error) == "x: found nothing"
    app.app.link.stop(1)


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


def test_a_recording_goes_on_while_the_camera_is_lost_and_ends_with_its_reference(
    tmp_path: Path, broker: Broker, seen: Subscriber, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    lose = threading.Event()

    def first() -> Iterator[Any]:
        while not lose.is_set():
            yield from paced(pictures.free, 2)
        yield GONE

    folder = tmp_path / "recs" / "one"
    app = Running(document(tmp_path, broker.port), scripted(first(), GONE, paced(pictures.free)), calibration)
    try:
        wait_until(lambda: last(seen, "status/camera").get("state") == "streaming", 10, "streaming")
        wait_until(lambda: last(seen, "status/recorder") == {"state": "idle", **NO_REASON}, 5, "idle")
        assert ask(seen, "record", action="stop") == {
            "ok": False,
            "error": "found no recording to stop",
            "reason_code": "no_recording",
        }
        started = ask(seen, "record", action="start", seconds=600, name="one")
        assert started == {"ok": True, "result": {"folder": str(folder)}}
        again = ask(seen, "record", action="start", seconds=600, name="two")
        assert again == {"ok": False, "error": f"busy: recording to {folder}", "reason_code": "busy"}
        wait_until(lambda: last(seen, "status/recorder")["frames"] > 5, 10, "frames")
        assert last(seen, "status/recorder")["state"] == "recording"
        marked = ask(seen, "record", action="mark", text="now")
        assert marked["result"]["folder"] == str(folder)
        lose.set()
        cameras = f"{BASE}/status/camera"
        wait_until(lambda: any(str(GONE).encode() in told for told in seen.of(cameras)), 10, "lost")
        wait_until(lambda: last(seen, "status/camera")["state"] == "streaming", 10, "back")
        frames = last(seen, "status/recorder")["frames"]
        ask(seen, "profile", profile="paper")
        ask(seen, "profile", profile="fast")
        wait_until(lambda: last(seen, "status/recorder")["frames"] > frames + 5, 10, "more frames")
        crc = ask(seen, "reference")["result"]["calibration_crc32"]
        wait_until(lambda: last(seen, "status/recorder")["state"] == "stopped", 10, "stopped")
        status = last(seen, "status/recorder")
        assert status["reason"] == status["ending"] == "another reference or calibration came into use"
        assert status["reason_code"] == status["ending_code"] == "calibration_changed"
        told = {"written": status["frames"], "dropped": 0, "waiting": 0}
        wait_until(lambda: last(seen, "health")["recorder"] == told, 5, f"health tells {told}")

        # The next has the new reference beside it, and a stop that is answered when all is written.
        ask(seen, "record", action="start", seconds=600, name="two")
        wait_until(lambda: last(seen, "status/recorder")["frames"] > 5, 10, "frames")
        stopped = ask(seen, "record", action="stop")["result"]
        assert (stopped["ending"], stopped["ending_code"]) == ("stopped", "stopped")
        assert len(read_table(tmp_path / "recs" / "two" / "frames.csv")) == stopped["frames"]
        assert calibration_file.load(tmp_path / "recs" / "two" / "calibration.npz").crc32 == crc
        wait_until(lambda: last(seen, "status/recorder")["state"] == "idle", 5, "idle")
    finally:
        app.end()
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert events.pop(1)["data"] == {"text": "now"}
    assert [event["kind"] for event in events] == ["start", "source", "source", *["reconstruction"] * 3]
    assert [event["data"]["state"] for event in events[:3]] == ["streaming", "away", "streaming"]
    assert (events[1]["data"]["reason"], events[1]["data"]["reason_code"]) == (str(GONE), "device")
    assert [event["data"]["profile"] for event in events[3:]] == ["paper", "fast", "fast"]
    crcs = [event["data"]["calibration_crc32"] for event in events[3:]]
    assert crcs == [calibration.crc32, calibration.crc32, crc]
    assert calibration_file.load(folder / "calibration.npz").crc32 == calibration.crc32
    rows = read_table(folder / "frames.csv")
    lost_ns = events[1]["t_ns"]
    assert rows[0].t_ns < lost_ns < rows[-1].t_ns


@pytest.mark.parametrize("format_", ["folder", "mcap"])
def test_a_recording_begins_before_it_is_asked_for(
    tmp_path: Path,
    broker: Broker,
    seen: Subscriber,
    calibration: Calibration,
    pictures: Any,
    scripted: Any,
    format_: str,
) -> None:
    if format_ == "mcap":
        pytest.importorskip("mcap")
        pytest.importorskip("foxglove_schemas_protobuf")
    settings = document(tmp_path, broker.port)
    settings.path.write_text(settings.path.read_text().replace("recs}", "recs, before_s: 30}"))
    app = Running(load(settings.path), scripted(paced(pictures.free)), calibration)
    try:
        wait_until(lambda: last(seen, "health").get("recorder", {}).get("before", 0) > 20, 10, "frames are kept")
        assert ask(seen, "record", action="start", seconds=600, name="one", format=format_)["ok"]
        assert ask(seen, "record", action="mark")["ok"]
        stopped = ask(seen, "record", action="stop")["result"]
        told = {"written": stopped["frames"], "dropped": 0, "waiting": 0, "before_dropped": 0}
        wait_until(lambda: told.items() <= last(seen, "health")["recorder"].items(), 5, f"health tells {told}")
    finally:
        app.end()
    folder = tmp_path / "recs" / "one"
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    asked_ns = next(event["t_ns"] for event in events if event["kind"] == "start")
    recording, times_ns = Recording(folder), list[int]()
    while (read := recording.read()) is not None:
        times_ns.append(read.frame.t_ns)
    assert len(times_ns) == stopped["frames"]
    assert sum(t_ns < asked_ns for t_ns in times_ns) > 20
