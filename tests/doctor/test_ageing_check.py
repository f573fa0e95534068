"""What the doctor says of a sensor's history."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.findings import checked
from support.painted_sensor import painted_calibration
from tacshade_edge.calibration.ageing.wears import COLUMNS, RECENT, History
from tacshade_edge.calibration.files import ageing_file
from tacshade_edge.doctor.ageing_check import check_ageing

KNOWN = painted_calibration()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "c.ageing.npz"


def keep(path: Path, days: int, **values: float) -> None:
    looks = np.zeros((days, len(COLUMNS)), np.float32)
    for name, value in values.items():
        looks[:, COLUMNS.index(name)] = value
    numbers = np.arange(20_000, 20_000 + days, dtype=np.int32)
    ageing_file.save(path, KNOWN, History(numbers, looks))


def test_without_a_history_there_is_nothing_to_say(path: Path) -> None:
    assert check_ageing(path, KNOWN) == ()


def test_a_short_history_and_a_sound_sensor(path: Path) -> None:
    keep(path, RECENT - 1)
    (short,) = checked(check_ageing(path, KNOWN))
    assert short.state == "ok"
    assert short.found == "13 days since 2024-10-04 with a look at rest; judged from 14 on"
    keep(path, 40, white=-0.05, dark=-0.05)
    (sound,) = checked(check_ageing(path, KNOWN))
    assert sound.state == "ok"
    assert sound.found.endswith("light 5 %, markers 0 %, pins 0 %, gel 0.00 mm")


@pytest.mark.parametrize(
    ("values", "said", "fix"),
    [
        ({"white": -0.3, "dark": -0.3}, "the light has lost 26 %", "restore the lamps"),
        ({"white": -0.3}, "the markers have lost 26 %", "clean the lens"),
        ({"bent_part": 0.08}, "8 % of the pattern is another one", "replace the skin"),
        ({"sunk_mm": 0.15}, "sunk or swollen by 0.15 mm", "look for a leak"),
    ],
)
def test_each_wear_is_a_warning_with_its_fix(
    path: Path, values: dict[str, float], said: str, fix: str
) -> None:
    keep(path, 40, **values)
    (finding,) = checked(check_ageing(path, KNOWN))
    assert (finding.check, finding.state) == ("ageing", "warning")
    assert said in finding.found
    assert fix in finding.fix


def test_a_damaged_history_is_a_warning(path: Path) -> None:
    path.write_bytes(b"no history")
    (finding,) = checked(check_ageing(path, KNOWN))
    assert finding.state == "warning"
    assert "damaged" in finding.found
    assert f"move {path} away" in finding.fix
