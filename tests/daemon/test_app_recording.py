"""The daemon in this process records."""

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
    Running,
    ask,
    document,
    last,
    paced,
)

from tacshade_edge.settings import load
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.tables.frame_table import read_table
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


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
        assert again == {"ok": False, "error": f"busy: already recording to {folder}", "reason_code": "busy"}
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
        assert status["reason"] == status["ending"] == "the reference or calibration changed"
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
    settings.path.write_text(settings.path.read_text().replace("recs}", "recs, pre_roll_s: 30}"))
    app = Running(load(settings.path), scripted(paced(pictures.free)), calibration)
    try:
        wait_until(lambda: last(seen, "health").get("recorder", {}).get("pre_roll", 0) > 20, 10, "frames are kept")
        assert ask(seen, "record", action="start", seconds=600, name="one", format=format_)["ok"]
        assert ask(seen, "record", action="mark")["ok"]
        stopped = ask(seen, "record", action="stop")["result"]
        told = {"written": stopped["frames"], "dropped": 0, "waiting": 0, "pre_roll_dropped": 0}
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
