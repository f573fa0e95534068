"""Recordings with frames that the test hands over; test_app.py records a running daemon."""

from __future__ import annotations

import json
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.painted_sensor import FREE, TOUCHED
from support.patience import patience, wait_until
from tacshade_edge.daemon import live_recorder, pre_roll, record_thread
from tacshade_edge.daemon.live_recorder import LiveRecorder
from tacshade_edge.daemon.ongoing_recording import STOPPED, TIME
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.recording import recorder
from tacshade_edge.recording.frame_table import ROWS_MAX, read_table
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.recording_content import content_of, events_in
from tacshade_edge.settings import Recorder as SettingsOfRecorder
from tacshade_edge.settings import Settings
from tacshade_edge.types import Calibration, Frame
from tacshade_edge.wire.requests import RECORD_S_MAX

PRE_ROLL_S_MAX, FPS_MAX = 60, 240
"""The greatest that the settings take."""


class Live:
    """A recorder and the tap that the grab thread would use."""

    def __init__(self, calibration: Calibration, folder: Path) -> None:
        self.written: list[str] = []
        self.status: list[dict[str, Any]] = []
        self.recorder = LiveRecorder(
            lambda status: self.status.append(json.loads(status)), lambda: self.written.append("")
        )
        self.recorder.start()
        self.folder = folder / "recs" / "one"
        self._calibration = calibration

    def begin(self, seconds: float = 60.0, name: str = "one") -> None:
        folder = self.folder.with_name(name)
        self.recorder.begin(folder, seconds, "sensor_id: a\n", self._calibration, {"version": "1"})

    def give(self, *frames: Frame) -> None:
        for frame in frames:
            if tap := self.recorder.tap:
                tap(frame)

    def ended(self) -> dict[str, Any]:
        """The status when the recording is written."""

        def poll() -> bool:
            self.recorder.poll()
            return self.recorder.now() is None

        wait_until(poll, 20, "the recording has ended")
        return self.status[-1]

    def about(self) -> dict[str, Any]:
        read: dict[str, Any] = json.loads((self.folder / "recording.json").read_text())
        return read

    def events(self) -> list[dict[str, Any]]:
        return [
            json.loads(line) for line in (self.folder / "events.jsonl").read_text().splitlines()
        ]

    def until(self, **counts: int) -> None:
        wait_until(lambda: counts.items() <= self.recorder.health().items(), 20, f"{counts}")


@pytest.fixture
def short_queue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recorders that are made from now on have three frames' room for what waits."""
    monkeypatch.setattr(record_thread, "QUEUE_BYTES", 3 * FREE.nbytes)


@pytest.fixture
def live(calibration: Calibration, tmp_path: Path) -> Iterator[Live]:
    before = set(threading.enumerate())  # an app that a test let crash leaves its threads
    made = Live(calibration, tmp_path)
    yield made
    made.recorder.stop(patience(20))
    assert set(threading.enumerate()) <= before


def frames(count: int, first: int = 0) -> list[Frame]:
    return [Frame(k, 1000 + k, 5 + k, (FREE, TOUCHED)[k % 2]) for k in range(first, first + count)]


def test_what_was_captured_between_start_and_end_is_there(live: Live) -> None:
    live.give(*frames(1))
    live.begin()
    live.give(*frames(5, 1))
    live.recorder.event("source", state="away")
    live.recorder.end(STOPPED)
    live.give(*frames(1, 6))
    status = live.ended()
    assert (status["state"], status["frames"], status["dropped"], status["ending"]) == (
        "idle",
        5,
        0,
        "stopped",
    )
    rows = read_table(live.folder / "frames.csv")
    assert [row.t_ns for row in rows] == [1001, 1002, 1003, 1004, 1005]
    assert status["bytes"] == sum((live.folder / row.image).stat().st_size for row in rows)
    recording = Recording(live.folder)
    for frame in frames(5, 1):
        read = recording.read()
        assert read is not None
        np.testing.assert_array_equal(read.frame.image, frame.image)
    assert [(event["kind"], event["data"]) for event in live.events()] == [
        ("source", {"state": "away"})
    ]
    about = live.about()
    assert (about["ending"], about["first_t_ns"], about["first_wall_ns"], about["version"]) == (
        "stopped",
        1001,
        6,
        "1",
    )
    assert live.recorder.health() == {"written": 5, "dropped": 0, "waiting": 0}
    assert live.written == [""]


def test_the_time_ends_it_and_a_later_frame_is_not_in_it(live: Live) -> None:
    live.begin(0.05)
    live.give(*frames(2), Frame(2, 2**61, 0, FREE))
    status = live.ended()
    assert (status["frames"], status["ending"]) == (2, str(TIME))


def held_in_first_write(live: Live, monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Begin a recording whose writer holds the first frame until the event is set."""
    go_on, writing = threading.Event(), threading.Event()
    real = RecordingWriter.add

    def slow(self: RecordingWriter, frame: Frame, png: bytes) -> bool:
        writing.set()
        assert go_on.wait(patience(20))
        return real(self, frame, png)

    monkeypatch.setattr(RecordingWriter, "add", slow)
    live.begin()
    live.give(*frames(1))
    assert writing.wait(patience(20))
    return go_on


@pytest.mark.usefixtures("short_queue")
def test_a_disk_that_is_too_slow_loses_frames_and_counts_them(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = held_in_first_write(live, monkeypatch)
    live.give(*frames(7, 1))  # the first is in the writer's hands, three wait
    assert live.recorder.health() == {"written": 0, "dropped": 4, "waiting": 4}
    live.recorder.event("still there")
    go_on.set()
    live.recorder.end(STOPPED)
    status = live.ended()
    assert (status["frames"], status["dropped"], live.about()["dropped"]) == (4, 4, 4)
    assert live.events()[0]["kind"] == "still there"


def test_a_frame_larger_than_the_queue_does_not_keep_a_recording_from_its_end(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = held_in_first_write(live, monkeypatch)
    large = np.zeros((4500, 4500), np.uint8)
    assert large.nbytes > record_thread.QUEUE_BYTES + live_recorder.EVENTS_RESERVE_BYTES
    live.give(Frame(1, 1001, 6, large))
    live.recorder.end(STOPPED)
    go_on.set()
    assert live.ended()["frames"] == 2


def test_another_reference_ends_it_another_profile_does_not(
    live: Live, calibration: Calibration
) -> None:
    live.begin()
    live.give(*frames(2))
    live.recorder.reconstructs_with("paper", calibration.crc32)
    live.give(*frames(2, 2))
    live.recorder.reconstructs_with("paper", 77)
    live.give(*frames(2, 4))
    status = live.ended()
    assert (status["state"], status["frames"], status["ending_code"]) == (
        "stopped",
        4,
        "calibration_changed",
    )
    assert [event["data"]["calibration_crc32"] for event in live.events()] == [
        calibration.crc32,
        77,
    ]


def test_one_at_a_time_and_no_folder_twice(live: Live) -> None:
    live.begin()
    with pytest.raises(DeviceError, match=r"busy: already recording to .*one"):
        live.begin(name="two")
    live.recorder.end(STOPPED)
    live.ended()
    with pytest.raises(
        ConfigError, match=r"one: already exists, expected the name of a new folder"
    ):
        live.begin()
    live.begin(name="two")
    live.recorder.end(STOPPED)
    assert live.ended()["folder"].endswith("two")


def test_a_disk_that_comes_to_its_floor_ends_it(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = threading.Event()
    real = RecordingWriter.add
    monkeypatch.setattr(
        RecordingWriter,
        "add",
        lambda self, *shot: not full.is_set() and real(self, *shot),
    )
    live.begin()
    live.give(*frames(2))
    live.until(written=2)
    full.set()
    live.give(*frames(3, 2))
    status = live.ended()
    assert (status["state"], status["reason"]) == ("stopped", "less than 256 MiB free on the disk")
    assert status["frames"] == len(read_table(live.folder / "frames.csv")) == 2
    assert 1 <= status["dropped"] <= 3  # what came after the end is not its own
    assert live.about()["ending_code"] == "disk_full"
    monkeypatch.setattr("tacshade_edge.files.atomic_files.FREE_FLOOR_BYTES", 2**62)
    with pytest.raises(DeviceError, match=r"recs: found \d+ MiB free on the disk, expected"):
        live.begin(name="two")
    assert live.recorder.tap is None


def _folder_gone(folder: Path) -> None:
    os.rename(folder, folder.with_name("moved"))


def _folder_is_a_file(folder: Path) -> None:
    _folder_gone(folder)
    folder.touch()


def test_more_marks_than_a_replay_reads_end_it(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is written until then is read; here a replay reads less."""
    monkeypatch.setattr(recorder, "EVENTS_BYTES_MAX", 2000)
    live.begin()
    live.give(Frame(0, time.monotonic_ns(), 0, FREE))
    live.until(written=1)
    for _ in range(100):
        live.recorder.event("mark", text="\u00e4" * 20)
    status = live.ended()
    assert (status["state"], status["ending_code"]) == ("stopped", "recording_full")
    assert 1800 < (live.folder / "events.jsonl").stat().st_size <= 2000
    assert len(live.events()) == len(list(events_in(content_of(live.folder)))) > 5
    assert live.about()["frames"] == len(read_table(live.folder / "frames.csv")) == 1


def test_the_longest_recording_has_a_table_that_is_read() -> None:
    assert (RECORD_S_MAX + PRE_ROLL_S_MAX) * FPS_MAX < ROWS_MAX


@pytest.mark.parametrize("happen", [_folder_gone, _folder_is_a_file])
def test_a_folder_that_goes_away_ends_it_with_its_error(
    live: Live, happen: Callable[[Path], None]
) -> None:
    live.begin()
    live.give(*frames(1))
    live.until(written=1)
    happen(live.folder)
    live.give(*frames(1, 1))
    status = live.ended()
    assert (status["frames"], status["dropped"], status["reason_code"]) == (1, 1, "disk")
    assert re.search(r"/one.*: cannot write it: ", status["reason"])
    left = Recording(live.folder.with_name("moved"))
    assert left.cut_off
    assert left.read() is not None
    assert left.read() is None


def now(count: int, first: int = 0) -> list[Frame]:
    return [replace(frame, t_ns=time.monotonic_ns()) for frame in frames(count, first)]


def keep(live: Live, pre_roll_s: float) -> None:
    live.recorder.settings_changed(Settings(recorder=SettingsOfRecorder(pre_roll_s=pre_roll_s)))


def written(folder: Path) -> list[int]:
    """Capture times; the images are the painted pictures in turn."""
    recording, times_ns = Recording(folder), list[int]()
    while (read := recording.read()) is not None:
        np.testing.assert_array_equal(read.frame.image, (FREE, TOUCHED)[len(times_ns) % 2])
        times_ns.append(read.frame.t_ns)
    return times_ns


def test_a_recording_begins_with_what_was_before(live: Live, calibration: Calibration) -> None:
    live.recorder.reconstructs_with("fast", calibration.crc32)
    keep(live, 30.0)
    too_old = replace(frames(1)[0], t_ns=time.monotonic_ns() - 40 * 10**9)
    before = now(4)
    live.give(too_old, *before)
    live.recorder.event("source", state="away")
    live.until(pre_roll=4)
    live.begin()
    live.recorder.event("start")
    after = now(3, 4)
    live.give(*after)
    live.recorder.end(STOPPED)
    status = live.ended()
    assert (status["frames"], status["dropped"], status["ending"]) == (7, 0, "stopped")
    assert written(live.folder) == [frame.t_ns for frame in (*before, *after)]
    assert [event["kind"] for event in live.events()] == ["source", "start"]
    assert before[-1].t_ns < live.events()[1]["t_ns"] < after[0].t_ns
    assert live.about()["first_t_ns"] == before[0].t_ns
    live.until(written=7, dropped=0, waiting=0, pre_roll=0, pre_roll_dropped=0)
    live.give(*now(2))  # what a recording has is not kept for the next one
    live.until(pre_roll=2)
    keep(live, 0.0)
    assert live.recorder.tap is None


def test_what_is_kept_is_bounded_and_what_finds_no_room_is_counted(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = len(png_of(FREE)) + len(png_of(TOUCHED))
    monkeypatch.setattr(pre_roll, "PRE_ROLL_BYTES", 2 * size)
    keep(live, 30.0)
    given = now(10)
    live.give(*given)
    live.until(pre_roll_dropped=6, pre_roll=4)
    live.begin()
    live.recorder.end(STOPPED)
    assert live.ended()["dropped"] == 0
    assert written(live.folder) == [frame.t_ns for frame in given[6:]]
    assert live.recorder.health()["pre_roll_dropped"] == 6


def test_frames_of_another_reference_are_not_before(live: Live, calibration: Calibration) -> None:
    live.recorder.reconstructs_with("fast", 77)
    keep(live, 30.0)
    live.give(*now(3))
    live.until(pre_roll=3)
    live.recorder.reconstructs_with("accurate", 77)
    live.recorder.reconstructs_with("accurate", calibration.crc32)
    after = now(2)
    live.give(*after)
    live.until(pre_roll=2)
    live.begin()
    live.recorder.end(STOPPED)
    live.ended()
    assert written(live.folder) == [frame.t_ns for frame in after]


def test_a_clock_that_is_set_is_an_event_and_the_times_go_on(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    live.begin()
    began_ns, wall_ns = time.monotonic_ns(), 1_790_000_000_000_000_000
    jumps_s = (-86_400.0, 30 * 86_400.0, 0.05)
    offset_ns = time.time_ns() - time.monotonic_ns()
    for k, jump_s in enumerate(jumps_s):
        live.give(Frame(k, began_ns + k, wall_ns + k, FREE))
        offset_ns += round(jump_s * 1e9)
        monkeypatch.setattr(
            live_recorder, "_wall_minus_t_ns", lambda offset_ns=offset_ns: offset_ns
        )
        live.recorder.poll()
        wall_ns += round(jump_s * 1e9)
    live.recorder.end(STOPPED)
    live.ended()
    clock = [event["data"]["jump_s"] for event in live.events() if event["kind"] == "clock"]
    assert clock == pytest.approx(jumps_s[:2], abs=0.1)  # a clock that is slewed has not jumped
    recording = Recording(live.folder)
    frames = [frame for _ in jumps_s if (frame := recording.read()) is not None]
    assert [frame.frame.t_ns for frame in frames] == [began_ns + k for k in range(3)]
    # One offset for the whole recording: the Unix times go on, too.
    assert [frame.wall_ns for frame in frames] == [1_790_000_000_000_000_000 + k for k in range(3)]
