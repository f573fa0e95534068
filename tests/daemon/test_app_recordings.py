"""Recordings of the daemon in this process: real threads, a real broker, a scripted camera."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from support.patience import wait_until
from support.running_app import GONE, NO_REASON, Live, paced
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.recording.frame_table import read_table
from tacshade_edge.recording.recording import Recording
from tacshade_edge.settings import load

pytestmark = pytest.mark.broker


def test_a_recording_goes_on_while_the_camera_is_lost_and_ends_with_its_reference(
    live: Live, pictures: Any, scripted: Any
) -> None:
    lose = threading.Event()

    def first() -> Iterator[Any]:
        while not lose.is_set():
            yield from paced(pictures.free, 2)
        yield GONE

    def recorded() -> Any:
        return live.last("status/recorder")

    folder = live.folder / "recs" / "one"
    with live.run(scripted(first(), GONE, paced(pictures.free))):
        live.until("status/camera", state="streaming")
        wait_until(lambda: recorded() == {"state": "idle", **NO_REASON}, 5, "idle")
        assert live.ask("record", action="stop")["reason_code"] == "no_recording"
        started = live.ask("record", action="start", seconds=600, name="one")
        assert started == {"ok": True, "result": {"folder": str(folder)}}
        again = live.ask("record", action="start", seconds=600, name="two")
        assert again == {
            "ok": False,
            "error": f"busy: already recording to {folder}",
            "reason_code": "busy",
        }
        wait_until(lambda: recorded()["frames"] > 5, 10, "frames")
        assert recorded()["state"] == "recording"
        assert live.ask("record", action="mark", text="now")["result"]["folder"] == str(folder)
        lose.set()
        wait_until(
            lambda: any(str(GONE).encode() in each for each in live.payloads("status/camera")),
            10,
            "lost",
        )
        live.until("status/camera", state="streaming")
        frames = recorded()["frames"]
        live.ask("profile", profile="paper")
        live.ask("profile", profile="fast")
        wait_until(lambda: recorded()["frames"] > frames + 5, 10, "more frames")
        crc = live.ask("reference")["result"]["calibration_crc32"]
        status = live.until("status/recorder", state="stopped")
        assert status["reason"] == status["ending"] == "the reference or calibration changed"
        assert status["reason_code"] == status["ending_code"] == "calibration_changed"
        live.until("health", recorder={"written": status["frames"], "dropped": 0, "waiting": 0})

        # The next has the new reference beside it, and a stop that is answered when all is written.
        live.ask("record", action="start", seconds=600, name="two")
        wait_until(
            lambda: recorded()["state"] == "recording" and recorded()["frames"] > 5, 10, "frames"
        )
        stopped = live.ask("record", action="stop")["result"]
        assert (stopped["ending"], stopped["ending_code"]) == ("stopped", "stopped")
        assert len(read_table(live.folder / "recs" / "two" / "frames.csv")) == stopped["frames"]
        assert calibration_file.load(live.folder / "recs" / "two" / "calibration.npz").crc32 == crc
        live.until("status/recorder", state="idle")
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert events.pop(1)["data"] == {"text": "now"}
    assert [event["kind"] for event in events] == [
        "start",
        "source",
        "source",
        *["reconstruction"] * 3,
    ]
    assert [event["data"]["state"] for event in events[:3]] == ["streaming", "away", "streaming"]
    assert (events[1]["data"]["reason"], events[1]["data"]["reason_code"]) == (str(GONE), "device")
    assert [event["data"]["profile"] for event in events[3:]] == ["paper", "fast", "fast"]
    crcs = [event["data"]["calibration_crc32"] for event in events[3:]]
    assert crcs == [live.calibration.crc32, live.calibration.crc32, crc]
    assert calibration_file.load(folder / "calibration.npz").crc32 == live.calibration.crc32
    rows = read_table(folder / "frames.csv")
    assert rows[0].t_ns < events[1]["t_ns"] < rows[-1].t_ns


def test_a_recording_begins_before_it_is_asked_for(
    live: Live, pictures: Any, scripted: Any
) -> None:
    path = live.document().path
    path.write_text(path.read_text().replace("recs}", "recs, pre_roll_s: 30}"))
    with live.run(scripted(paced(pictures.free)), load(path)):
        wait_until(
            lambda: live.last("health").get("recorder", {}).get("pre_roll", 0) > 20,
            10,
            "frames are kept",
        )
        assert live.ask("record", action="start", seconds=600, name="one")["ok"]
        assert live.ask("record", action="mark")["ok"]
        stopped = live.ask("record", action="stop")["result"]
        counts = {"written": stopped["frames"], "dropped": 0, "waiting": 0, "pre_roll_dropped": 0}
        wait_until(
            lambda: counts.items() <= live.last("health")["recorder"].items(),
            5,
            f"health reports {counts}",
        )
    folder = live.folder / "recs" / "one"
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    start_ns = next(event["t_ns"] for event in events if event["kind"] == "start")
    recording, times_ns = Recording(folder), list[int]()
    while (read := recording.read()) is not None:
        times_ns.append(read.frame.t_ns)
    assert len(times_ns) == stopped["frames"]
    assert sum(t_ns < start_ns for t_ns in times_ns) > 20
