from __future__ import annotations

import shutil
import threading
from pathlib import Path

import cv2
import pytest
from painted_sensor import FREE

from tacshade_edge.daemon.record import record
from tacshade_edge.daemon.workers import SourceState
from tacshade_edge.devices.files import FilesSource
from tacshade_edge.devices.recorder import Recorder
from tacshade_edge.errors import ConfigError, DeviceError


def source(folder: Path, *, loop: bool) -> FilesSource:
    cv2.imwrite(str(folder / "a.png"), FREE)
    return FilesSource(path=folder / "a.png", fps=100, loop=loop)


def grabbing() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name in ("grab", "write")]


def test_states_are_told_and_the_threads_end(tmp_path: Path) -> None:
    told: list[SourceState] = []
    recorder = Recorder(tmp_path / "rec", free_floor_bytes=0)
    ending = record(
        source(tmp_path, loop=True), recorder, seconds=60, stopped=lambda: recorder.frames >= 5, told=told.append
    )
    assert ending == "stopped"
    assert [state.state for state in told] == ["streaming"]
    assert recorder.frames >= 5
    assert grabbing() == []


def test_a_folder_that_goes_away_ends_it_with_its_error(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "rec", free_floor_bytes=0)

    def gone(state: SourceState) -> None:
        shutil.rmtree(tmp_path / "rec", ignore_errors=True)

    with pytest.raises(DeviceError, match=r"rec.*: cannot be written"):
        record(source(tmp_path, loop=True), recorder, seconds=60, stopped=lambda: False, told=gone)
    assert grabbing() == []


def test_a_source_that_can_never_work(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "rec", free_floor_bytes=0)
    never = FilesSource(path=tmp_path / "none", fps=100, loop=False)
    with pytest.raises(ConfigError, match="none: found nothing"):
        record(never, recorder, seconds=60, stopped=lambda: False, told=lambda state: None)
    assert grabbing() == []
