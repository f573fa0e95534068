"""The history of looks in its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.painted_sensor import painted_calibration
from tacshade_edge.calibration.ageing.wears import COLUMNS, DAYS_MAX, History
from tacshade_edge.calibration.files import ageing_file, reference_file
from tacshade_edge.calibration.files.reference_file import belongs_to
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.npz import Content

KNOWN = painted_calibration()
HISTORY = History(np.array([20_000, 20_003], np.int32), np.full((2, len(COLUMNS)), 0.1, np.float32))


def test_it_lies_beside_the_calibration_and_holds_what_was_saved(tmp_path: Path) -> None:
    path = ageing_file.path_beside(tmp_path / "left.hand.npz")
    assert path.name == "left.hand.ageing.npz"
    stored = reference_file.path_beside(tmp_path / "left.hand.npz")
    assert ageing_file.path_beside_reference(stored) == path
    assert not len(ageing_file.load(path, KNOWN).days)
    ageing_file.save(path, KNOWN, HISTORY)
    found = ageing_file.load(path, KNOWN)
    assert found.days.tolist() == [20_000, 20_003]
    assert np.array_equal(found.looks, HISTORY.looks)


def test_the_history_of_another_reference_is_none(tmp_path: Path) -> None:
    path = tmp_path / "c.ageing.npz"
    ageing_file.save(path, KNOWN, HISTORY)
    other = replace(KNOWN, reference_grey=KNOWN.reference_grey // 2)
    assert not len(ageing_file.load(path, other).days)
    assert len(ageing_file.load(path, replace(KNOWN, factors={})).days) == 2


def written(path: Path, days: object, looks: object, version: int = 1) -> None:
    meta = {"version": version, "belongs_to": belongs_to(KNOWN), "columns": list(COLUMNS)}
    path.write_bytes(Content(meta, {"days": days, "looks": looks}).packed())


@pytest.mark.parametrize(
    ("days", "looks", "said"),
    [
        ([5, 5], np.zeros((2, 6)), "days that do not increase"),
        ([-1, 5], np.zeros((2, 6)), "days that do not increase"),
        ([5, 2**31 - 1], np.zeros((2, 6)), "are no dates"),
        ([5, 6], np.zeros((2, 5)), r"\(2,\) days and \(2, 5\) looks"),
        ([5], np.full((1, 6), np.nan), "a look that no camera takes"),
        ([5], np.full((1, 6), 1e9), "a look that no camera takes"),
        (np.arange(DAYS_MAX + 1), np.zeros((DAYS_MAX + 1, 6)), "days and"),
    ],
)
def test_what_the_daemon_never_writes_is_refused(
    tmp_path: Path, days: object, looks: np.ndarray, said: str
) -> None:
    path = tmp_path / "c.ageing.npz"
    written(path, np.array(days, np.int32), looks.astype(np.float32))
    with pytest.raises(ConfigError, match=said):
        ageing_file.load(path, KNOWN)


def test_damage_another_version_and_other_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.ageing.npz"
    ageing_file.save(path, KNOWN, HISTORY)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ConfigError, match="damaged or not a history of references"):
        ageing_file.load(path, KNOWN)
    written(path, HISTORY.days, HISTORY.looks, version=2)
    with pytest.raises(ConfigError, match=r"found version 2 .* expected 1; delete it"):
        ageing_file.load(path, KNOWN)
    written(path, HISTORY.days.astype(np.float32), HISTORY.looks)
    with pytest.raises(ConfigError, match="found float32 days"):
        ageing_file.load(path, KNOWN)


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="gone"):
        ageing_file.save(tmp_path / "gone" / "c.ageing.npz", KNOWN, HISTORY)
