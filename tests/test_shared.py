"""What one worker of the tests makes is what the others read."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from support import shared
from support.calibrated_sensor import calibrated


def test_it_is_made_once_and_comes_back_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = calibrated(count=0)
    monkeypatch.setattr(shared, "folder", tmp_path)
    first = shared.once_for_all_workers("a", lambda: whole)
    second = shared.once_for_all_workers("a", lambda: pytest.fail("made again"))
    for read in (first, second):
        for field in fields(whole):
            np.testing.assert_equal(getattr(read, field.name), getattr(whole, field.name), field.name)
        assert read.reference_white.dtype == np.uint8
        assert not read.reference_white.flags.writeable


def test_arrays_come_back_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared, "folder", tmp_path)
    read = shared.once_for_all_workers("a", lambda: np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(read, [[0, 1, 2], [3, 4, 5]])
    assert not read.flags.writeable


def test_another_name_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared, "folder", tmp_path)
    assert [shared.once_for_all_workers(name, lambda made=name: made) for name in ("a", "b")] == ["a", "b"]
