"""A running daemon looks once a day, keeps what it saw, and says what ages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.resting_sensor import Resting
from tacshade_edge.calibration.ageing.wears import RECENT
from tacshade_edge.calibration.files import ageing_file
from tacshade_edge.daemon import ageing_watch
from tacshade_edge.daemon.ageing_watch import AgeingWatch
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.types import Calibration

DAY_S = 86400


class Clock:
    """The wall clock of the watch."""

    def __init__(self) -> None:
        self.day = 20_000

    def time(self) -> float:
        return self.day * DAY_S + 3600.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(ageing_watch, "time", made)
    return made


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "c.ageing.npz"


def test_the_followed_frames_are_looked_at_once_a_day(
    calibration: Calibration, tmp_path: Path, pictures: Any, clock: Clock
) -> None:
    resting = Resting(calibration, tmp_path / "c.reference.npz")
    assert resting.health["ageing"]["days"] == 0
    resting.look(pictures.free)
    resting.look(pictures.free)
    assert resting.health["ageing"]["days"] == 1
    clock.day += 1
    resting.look(pictures.free, held=True)
    assert resting.health["ageing"]["days"] == 1
    resting.look(pictures.free)
    assert resting.health["ageing"] == {
        "days": 2,
        "ageing": [],
        "wears": {},
        "reason": "",
        "reason_code": "",
    }
    again = AgeingWatch(calibration, tmp_path / "c.ageing.npz")
    assert again.health()["days"] == 2


def test_it_names_what_ages_once_and_when(
    calibration: Calibration,
    path: Path,
    pictures: Any,
    clock: Clock,
    caplog: pytest.LogCaptureFixture,
) -> None:
    watch = AgeingWatch(calibration, path)
    for k in range(2 * RECENT):
        clock.day += 1
        watch.see([camera_faults.gain(pictures.free, 1 - 0.012 * k)], owned=True)
    found = watch.health()
    assert found["ageing"] == ["light"]
    light = found["wears"]["light"]
    assert (light["limit"], light["unit"]) == (0.5, "of the light")
    # What three in four of the latest looks exceed.
    assert light["amount"] == pytest.approx(0.012 * 1.25 * RECENT, abs=0.03)
    assert light["per_year"] == pytest.approx(0.012 * 365, rel=0.2)
    assert light["until"] is not None
    (line,) = caplog.records
    assert line.getMessage().startswith("the sensor ages: the light has lost 1")
    # A restart says it in health, and does not warn again.
    again = AgeingWatch(calibration, path)
    assert again.health() == found
    again.see([pictures.free], owned=True)
    assert len(caplog.records) == 1


def test_a_damaged_history_is_refused_and_kept(
    calibration: Calibration,
    path: Path,
    pictures: Any,
    clock: Clock,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path.write_bytes(b"damaged")
    watch = AgeingWatch(calibration, path)
    watch.see([pictures.free], owned=True)
    assert watch.health()["reason_code"] == "config"
    assert str(path) in watch.health()["reason"]
    assert watch.health()["days"] == 0
    assert path.read_bytes() == b"damaged"
    assert len(caplog.records) == 1


def test_a_clock_that_went_back_adds_no_day(
    calibration: Calibration, path: Path, pictures: Any, clock: Clock
) -> None:
    watch = AgeingWatch(calibration, path)
    watch.see([pictures.free], owned=True)
    clock.day -= 300
    watch.see([pictures.free], owned=True)
    assert watch.health()["days"] == 1
    assert watch.health()["reason_code"] == "clock_went_back"
    assert "before 2024-10-04" in watch.health()["reason"]
    clock.day += 301
    watch.see([pictures.free], owned=True)
    assert (watch.health()["days"], watch.health()["reason"]) == (2, "")


def test_only_the_owner_of_the_folder_writes(
    calibration: Calibration, path: Path, pictures: Any, clock: Clock
) -> None:
    watch = AgeingWatch(calibration, path)
    watch.see([pictures.free], owned=False)
    assert not path.exists()
    assert watch.health()["days"] == 0


def test_a_folder_that_cannot_be_written_is_reported(
    calibration: Calibration, tmp_path: Path, pictures: Any, clock: Clock
) -> None:
    watch = AgeingWatch(calibration, tmp_path / "gone" / "c.ageing.npz")
    watch.see([pictures.free], owned=True)
    assert (watch.health()["days"], watch.health()["reason_code"]) == (1, "disk")


def test_another_calibration_begins_another_history(
    calibration: Calibration, tmp_path: Path, pictures: Any, clock: Clock
) -> None:
    resting = Resting(calibration, tmp_path / "c.reference.npz")
    resting.look(pictures.free)
    days = ageing_file.load(tmp_path / "c.ageing.npz", calibration).days
    assert np.array_equal(days, [clock.day])
    resting.references.reload(calibration, tmp_path / "another.reference.npz")
    assert resting.health["ageing"]["days"] == 0
