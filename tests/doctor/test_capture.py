from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import pytest

from tacshade_edge.doctor.capture import FRAMES, Captured, capture
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.recording.image_source import FilesSource
from tools.testbed.painted_sensor import FREE


def test_frames_of_a_looping_image(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), FREE)
    captured = capture(FilesSource(path=tmp_path, fps=240, loop=True))
    assert captured.error is None
    assert len(captured.t_ns) == len(captured.arrived_ns) == FRAMES
    assert len(captured.images) == 10, "memory is bounded"
    assert all(later > earlier for earlier, later in itertools.pairwise(captured.t_ns))
    assert 0 < captured.fps < 300
    assert captured.described["path"] == str(tmp_path)


def test_a_source_that_ends_early_or_breaks(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), FREE)
    assert len(capture(FilesSource(path=tmp_path, fps=30, loop=False)).t_ns) == 1
    (tmp_path / "b.png").write_bytes(b"")
    broken = capture(FilesSource(path=tmp_path, fps=240, loop=False))
    assert len(broken.t_ns) == 1
    assert "b.png" in str(broken.error)
    error = capture(FilesSource(path=tmp_path / "none", fps=30, loop=False)).error
    assert error is not None
    assert error.code is ReasonCode.CONFIG
    assert "found nothing" in error.text


def test_the_rate_leaves_out_the_first_frames() -> None:
    slow_start = (0, *(2_000_000_000 + k * 20_000_000 for k in range(20)))
    assert Captured(t_ns=slow_start).fps == pytest.approx(50)
    assert Captured(t_ns=(1, 2)).fps == 0
