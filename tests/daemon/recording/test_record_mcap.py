"""A recording in MCAP through the daemon's queue and thread, and what the next daemon does with one that was torn."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tools.testbed.painted_sensor import FREE, TOUCHED
from tools.testbed.patience import patience, wait_until

pytest.importorskip("mcap")
pytest.importorskip("foxglove_schemas_protobuf")

from tacshade_edge.daemon.record import STOPPED, LiveRecorder, Recorded
from tacshade_edge.daemon.record_requests import RecordRequests
from tacshade_edge.storage.recording.mcap_recorder import McapRecorder
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.types import Calibration, Frame


def test_a_recording_in_mcap_and_one_that_was_torn(
    calibration: Calibration, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    recorder = LiveRecorder(lambda _: None)
    folder = tmp_path / "one"
    recorder.start(folder, 60.0, "sensor_id: a\n", calibration, {}, partial(McapRecorder, sensor_id="a"))
    assert recorder.tap is not None
    for k in range(6):
        recorder.tap(Frame(k, 1000 + k, 5 + k, (FREE, TOUCHED)[k % 2]))
    wait_until(lambda: recorder.counts()["written"] == 6, 20, "the frames are written")
    torn = (folder / "000.mcap.part").read_bytes()
    recorder.end(STOPPED)
    found: list[Recorded] = []
    wait_until(lambda: bool(found) or bool(found.extend(filter(None, [recorder.poll()]))), 20, "it has ended")
    recorder.join(patience(20))
    assert (found[0].frames, found[0].dropped, found[0].ending) == (6, 0, STOPPED)
    (folder / "000.mcap").unlink()
    (folder / "000.mcap.part").write_bytes(torn[:-50])  # as if it had been killed
    with caplog.at_level(logging.WARNING):
        RecordRequests.fix(tmp_path)
    assert "000.mcap: repaired a recording that a daemon left unfinished when it died" in caplog.text
    recording = Recording(folder)
    assert not recording.cut_off
    frames = [recorded.frame for _ in range(4) if (recorded := recording.read()) is not None]
    np.testing.assert_array_equal(frames[3].image, TOUCHED)
    assert [frame.t_ns for frame in frames] == [1000, 1001, 1002, 1003]
