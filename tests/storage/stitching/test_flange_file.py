import json
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.core.stitching.flange import FoundFlange
from tacshade_edge.errors import DeviceError
from tacshade_edge.rigid import from_seven
from tacshade_edge.storage.stitching.flange_file import write_flange

SEVEN = (1.0, -2.0, 50.5, 0.8, 0.0, 0.6, 0.0)
FOUND = FoundFlange(from_seven(SEVEN), 12.3456, np.diag(np.square((0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 2.0))), 0.05)


def test_what_it_holds(tmp_path: Path) -> None:
    write_flange(tmp_path / "new", FOUND, delay_seen=True, presses=100, frames=180)
    about = json.loads((tmp_path / "new" / "flange.json").read_text())
    assert about["flange_T_sensor"] == pytest.approx(SEVEN)
    assert about["delay_ms"] == 12.346
    assert about["order"] == ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg", "delay_ms"]
    assert about["sigma"] == pytest.approx((0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 2.0))
    assert np.array(about["covariance"]) == pytest.approx(FOUND.covariance)
    assert (about["presses"], about["frames"], about["left_mm"]) == (100, 180, 0.05)


def test_a_delay_that_was_not_seen_is_null(tmp_path: Path) -> None:
    write_flange(tmp_path, FOUND, delay_seen=False, presses=100, frames=100)
    about = json.loads((tmp_path / "flange.json").read_text())
    assert about["delay_ms"] is None
    assert about["sigma"][6] is None
    assert about["covariance"][6] == [None] * 7
    assert [row[6] for row in about["covariance"]] == [None] * 7


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="cannot write it"):
        write_flange(tmp_path / "file" / "out", FOUND, delay_seen=True, presses=1, frames=1)
