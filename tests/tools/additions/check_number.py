"""What a new number of the calibration does without another line: found, kept, bounded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from support.painted_sensor import DISC, FREE, painted_calibration
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.inputs import StatedSensor


def test_it_is_found_and_survives_the_file(tmp_path: Path) -> None:
    sensor = StatedSensor(20.0, 30.0, 50.0, visible_circle=DISC, polarity="bright")
    found = calibrate(sensor, [FREE, FREE]).calibration
    assert found.skin_grey == pytest.approx(FREE.mean())
    calibration_file.save(tmp_path / "cal.npz", found)
    read = calibration_file.load(tmp_path / "cal.npz")
    assert read.skin_grey == found.skin_grey
    assert read.crc32 != calibration_file.with_crc(replace(found, skin_grey=0.0)).crc32


def test_a_number_that_no_sensor_has_is_refused() -> None:
    with pytest.raises(ValueError, match=r"skin_grey is 256\.0, which no sensor has"):
        replace(painted_calibration(), skin_grey=256.0)


def test_an_older_file_keeps_its_checksum() -> None:
    (path,) = Path(__file__).parents[2].glob("older-*.npz")
    read = calibration_file.load(path)
    assert read.skin_grey == 0.0
    assert f"older-{read.crc32:08x}.npz" == path.name
