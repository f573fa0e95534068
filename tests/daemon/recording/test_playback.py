from __future__ import annotations

import threading
from pathlib import Path
from queue import SimpleQueue

import pytest
from support.recordings import write_recording

from tacshade_edge.daemon.replay import Playback
from tacshade_edge.protocol.requests import PlaybackCommand
from tacshade_edge.storage.recording.recording import Recording
from tools.testbed.painted_sensor import FREE
from tools.testbed.patience import patience


def test_back_shows_the_frame_before_from_anywhere(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec", [FREE] * 6, period_ns=1_000_000)
    player = Playback(lambda: Recording(folder), 1.0, lambda _: None)
    shown: SimpleQueue[int] = SimpleQueue()

    def play() -> None:
        for _ in range(13):
            shown.put(player.read().frame.seq)

    thread = threading.Thread(target=play)
    thread.start()
    assert [shown.get(timeout=patience(20)) for _ in range(6)] == [0, 1, 2, 3, 4, 5]  # and waits at its end
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
