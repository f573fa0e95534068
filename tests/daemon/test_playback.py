"""Recordings replayed: reconstructed in order, played for a person, published."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from queue import SimpleQueue

import pytest

from support.mqtt_rig import Broker, Subscriber, free_port
from support.painted_sensor import BLACK, FREE, TOUCHED, painted_calibration
from support.patience import patience, wait_until
from support.recordings import write_recording
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.daemon.playback import Playback, PlaybackProgress, replay
from tacshade_edge.recording.recording import RecordedFrame, Recording
from tacshade_edge.recording.runs import CLOUDS, HEIGHTS, payloads
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire import binary
from tacshade_edge.wire.requests import PlaybackCommand

IMAGES = [FREE, TOUCHED, BLACK, TOUCHED]

PERIOD_NS = 20_000_000


def play(
    folder: Path, speed: float | None
) -> tuple[PlaybackProgress, list[tuple[int, bool, float]], list[str]]:
    """What was counted; sequence number, contact and our time of each delivery;
    and what was reported.
    """
    delivered: list[tuple[int, bool, float]] = []
    reported: list[str] = []

    def deliver(recorded: RecordedFrame, result: Reconstruction) -> None:
        assert result.t_ns == recorded.frame.t_ns
        delivered.append((result.seq, result.contact, time.monotonic()))

    progress = PlaybackProgress()
    reconstructor = make_reconstructor(painted_calibration(), PROFILES["fast"])
    replay(
        Recording(folder),
        reconstructor,
        [deliver],
        progress,
        speed=speed,
        undecodable=reported.append,
    )
    return progress, delivered, reported


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "rec", IMAGES, PERIOD_NS)


def test_every_frame_is_delivered_in_order_and_counted(folder: Path) -> None:
    progress, delivered, reported = play(folder, None)
    assert [(seq, contact) for seq, contact, _ in delivered] == [
        (0, False),
        (1, True),
        (2, False),
        (3, True),
    ]
    assert (progress.frames, progress.contacts, progress.invalid, progress.undecodable) == (
        4,
        2,
        1,
        0,
    )
    assert progress.recorded_seconds == pytest.approx(0.08)
    assert progress.speed_up == pytest.approx(0.08 / progress.seconds)
    assert progress.as_dict()["frames"] == 4
    assert reported == []


def test_no_frame_comes_before_its_time(folder: Path) -> None:
    speed = 0.5
    began = time.monotonic()
    _, delivered, _ = play(folder, speed)
    for seq, _, at in delivered:
        assert at - began >= seq * PERIOD_NS / 1e9 / speed - 1e-3


@pytest.mark.parametrize("speed", [100.0, 0.001, 1e-300])
def test_a_gap_of_decades_is_waited_for(
    tmp_path: Path, speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread waits for 292 years at most; here somebody wakes it."""
    folder, wait, waits_s = write_recording(tmp_path / "r", IMAGES, 2**60), threading.Event.wait, []

    def woken(event: threading.Event, timeout: float | None = None) -> bool:
        if timeout is not None and timeout > 3600:
            waits_s.append(timeout)
            threading.Timer(0.01, event.set).start()
        return wait(event, timeout)

    monkeypatch.setattr(threading.Event, "wait", woken)
    progress, _, _ = play(folder, speed)
    assert progress.frames == 4
    assert min(waits_s) > 86_400 * 365 * 0.3
    assert max(waits_s) <= threading.TIMEOUT_MAX


def test_what_cannot_be_read_is_reported_and_passed_over(folder: Path) -> None:
    (folder / "000000.png").unlink()
    progress, delivered, reported = play(folder, None)
    assert [seq for seq, _, _ in delivered] == [1, 2, 3]
    assert (progress.frames, progress.undecodable) == (3, 1)
    assert progress.recorded_seconds == pytest.approx(0.06)
    assert len(reported) == 1
    assert "000000.png: No such file" in reported[0]


def test_back_shows_the_frame_before_from_anywhere(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec", [FREE] * 6, period_ns=1_000_000)
    player = Playback(lambda: Recording(folder), 1.0, lambda _: None)
    shown: SimpleQueue[int] = SimpleQueue()

    def play() -> None:
        for _ in range(13):
            shown.put(player.read().frame.seq)

    thread = threading.Thread(target=play)
    thread.start()
    assert [shown.get(timeout=patience(20)) for _ in range(6)] == [
        0,
        1,
        2,
        3,
        4,
        5,
    ]  # and waits at its end
    asked: list[tuple[PlaybackCommand, int]] = [
        (PlaybackCommand(back=True), 4),
        (PlaybackCommand(back=True), 3),
        (PlaybackCommand(step=True), 4),
        (PlaybackCommand(seek_s=0.001), 1),
        (PlaybackCommand(back=True), 0),
        (PlaybackCommand(back=True), 0),
        (PlaybackCommand(step=True), 1),
    ]
    for command, seq in asked:
        player.command(command)
        assert shown.get(timeout=patience(20)) == seq, command
    thread.join(patience(20))
    assert player.status()["position_s"] == pytest.approx(0.001)
    assert player.status()["paused"]


BASE = "tacshade/replay"


@pytest.fixture
def given(tmp_path: Path) -> list[str]:
    calibration_file.save(tmp_path / "cal.npz", painted_calibration())
    write_recording(tmp_path / "rec", [FREE] * 5 + [TOUCHED] * 90 + [FREE] * 5)
    return ["replay", str(tmp_path / "rec"), "--calibration", str(tmp_path / "cal.npz")]


@pytest.mark.broker
def test_as_fast_as_possible_loses_nothing(
    tmp_path: Path, given: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with Broker(tmp_path) as broker, Subscriber(broker.port) as seen:
        assert main([*given, "--out", str(out), "--mqtt", f"127.0.0.1:{broker.port}"]) == 0
        seen.wait_for(f"{BASE}/state", 2)
        heights, clouds = seen.wait_for(f"{BASE}/height", 91), seen.of(f"{BASE}/cloud")
        assert json.loads(seen.of(f"{BASE}/info")[0])["profile"] == DEFAULT
        assert seen.of(f"{BASE}/state") == [b"online", b"stopped"]
        cameras = [json.loads(payload)["state"] for payload in seen.of(f"{BASE}/status/camera")]
        assert cameras == ["streaming", "ended"]
    # Every frame with contact and the one that ends it, the same bytes as in the files.
    assert heights == list(payloads(out, HEIGHTS))[5:96]
    decoded = [binary.decode(payload) for payload in heights]
    assert [m.pose.x_mm if m.pose else None for m in decoded[:4]] == [
        5.0,
        None,
        7.0,
        None,
    ]  # every other row has one
    assert clouds == list(payloads(out, CLOUDS))[5:95]
    assert "0 payloads superseded, 0 payloads failed" in capsys.readouterr().out


@pytest.mark.broker
def test_an_endless_loop_ends_cleanly_with_ctrl_c(tmp_path: Path, given: list[str]) -> None:
    with Broker(tmp_path) as broker, Subscriber(broker.port) as seen:
        more = [
            "--mqtt",
            f"127.0.0.1:{broker.port}",
            "--loop",
            "0",
            "--speed",
            "5",
            "--sensor-id",
            "left",
        ]
        command = [sys.executable, "-m", "tacshade_edge", *given, *more]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            wait_until(lambda: len(seen.of("tacshade/left/height")) > 91, 30, "more than one pass")
            child.send_signal(signal.SIGINT)
            said, errors = child.communicate(timeout=patience(20))
        finally:
            child.kill()
        assert child.returncode == 0, errors
        assert "frames, " in said
        seen.wait_for_last("tacshade/left/state", b"stopped")


@pytest.mark.slow
def test_a_broker_that_is_away_is_one_line(
    given: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    port = free_port()
    assert main([*given, "--mqtt", f"127.0.0.1:{port}"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    where = f"127.0.0.1:{port}"
    assert (
        f"{where}: Connection refused; expected a connection to the broker at {where} within 2 s"
        in err
    )
