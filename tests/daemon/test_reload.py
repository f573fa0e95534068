from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from tacshade_edge.daemon.app import reload
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import load
from tacshade_edge.storage import npz
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.npz import Content
from tools.testbed.painted_sensor import FREE, painted_calibration


def test_a_calibration_of_wrong_content_changes_nothing(tmp_path: Path) -> None:
    config, calibration = tmp_path / "settings.yaml", tmp_path / "calibration.npz"
    config.write_text("sensor_id: left\ncalibration: calibration.npz\nsource: {kind: files, path: .}\n")
    assert cv2.imwrite(str(tmp_path / "0.png"), FREE)
    stored = calibration_file.save(calibration, painted_calibration())
    running = load(config)
    found = reload(running, calibrated=True).calibration
    assert found is not None
    assert found.crc32 == stored.crc32
    content = npz.read(str(calibration), "calibration", "")
    for name, value in (("polarity", "x"), ("flange_T_sensor", []), ("factors", {"fast": "1"})):
        calibration.write_bytes(Content({**content.meta, name: value}, content.arrays).packed())
        with pytest.raises(ConfigError, match=rf"calibration\.npz: .*{name}.*; calibrate again"):
            reload(running, calibrated=True)
