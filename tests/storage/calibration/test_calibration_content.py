from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.core.calibration.inputs import Inputs, Sensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import calibrations
from tacshade_edge.storage import checked_npz
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.checked_npz import Content
from tools.testbed.painted_sensor import FREE, painted_calibration

_POSE = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
_FIT = {"presses": 1.0, "agreement_mae_mm": 0.1, "position_mae_mm": 0.1}
_WRONG: list[tuple[str, object]] = [
    *(("polarity", value) for value in ("x", 1, None)),
    *(("binarisation", value) for value in ("x", [])),
    *((name, value) for name in ("skin_radius_mm", "pitch_px", "row_c") for value in ("20", None, True, [], math.nan)),
    *((name, 1e-300) for name in ("skin_radius_mm", "radius_px", "visible_half_angle_deg")),
    ("camera_distance_mm", "x"),
    *(("factors", value) for value in ([], None, {"fast": "1"}, {"fast": math.nan})),
    *(("error_scales", value) for value in ([], None, {"fast": "1"}, {"fast": math.nan}, {"fast": 0.0}, {"fast": 1e9})),
    *(("fit", value) for value in ([], {"presses": 1.0}, {**_FIT, "presses": "1"}, {**_FIT, "presses": math.nan})),
    ("fit", {**_FIT, "fast_depth_mae_mm": 0.1}),
    ("fit", {**_FIT, "presses": math.inf}),
    *(("flange_T_sensor", value) for value in ([], None, _POSE[:6], ["0"] * 7, [0.0] * 7, [1e300] * 7)),
    ("flange_T_sensor", [math.nan, *_POSE[1:]]),
    *((name, np.zeros(shape, np.uint8)) for name in ("reference_white",) for shape in ((), (3,), (0, 0), (2, 2, 3))),
    ("reference_grey", np.zeros((7, 9), np.uint8)),
    ("reference_grey", np.zeros((480, 640), np.float32)),
]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Content:
    path = tmp_path_factory.mktemp("calibration") / "cal.npz"
    calibration_file.save(path, painted_calibration())
    return checked_npz.read(str(path), "calibration", "")[0]


def written(path: Path, meta: dict[str, Any], arrays: dict[str, Any]) -> Path:
    path.write_bytes(Content(meta, arrays).packed())
    return path


@pytest.mark.parametrize(("name", "value"), _WRONG)
def test_a_right_checksum_of_a_wrong_value_is_refused(
    tmp_path: Path, stored: Content, name: str, value: object
) -> None:
    meta, arrays = dict(stored.meta), dict(stored.arrays)
    (arrays if isinstance(value, np.ndarray) else meta)[name] = value
    path = written(tmp_path / "odd.npz", meta, arrays)
    with pytest.raises(ConfigError, match=r"odd\.npz: .*; calibrate again") as refusal:
        calibration_file.load(path)
    assert "\n" not in str(refusal.value)


def test_nothing_may_be_missing(tmp_path: Path, stored: Content) -> None:
    for name in stored.meta:
        meta = {key: value for key, value in stored.meta.items() if key != name}
        with pytest.raises(ConfigError, match=name):
            calibration_file.load(written(tmp_path / "odd.npz", meta, dict(stored.arrays)))
    calibration_file.load(written(tmp_path / "whole.npz", dict(stored.meta), dict(stored.arrays)))


def test_a_long_wrong_value_is_one_short_line(tmp_path: Path, stored: Content) -> None:
    for name in ("polarity", "version"):
        path = written(tmp_path / "odd.npz", {**stored.meta, name: "\x1b[31m" + "a" * 5000}, dict(stored.arrays))
        with pytest.raises(ConfigError, match="; calibrate again") as refusal:
            calibration_file.load(path)
        assert len(str(refusal.value)) < 500
        assert str(refusal.value).isprintable()


@pytest.mark.parametrize("version", ["../../x", "x\0", 6.5, True, None])
def test_a_version_that_is_no_number_names_no_file(tmp_path: Path, version: object) -> None:
    inputs = Inputs(Sensor(20.0, 30.0, 50.0, "bright"), (FREE,))
    calibration_file.save(tmp_path / "c.npz", painted_calibration(), inputs)
    content, _ = checked_npz.read(str(tmp_path / "c.npz"), "", "")
    written(tmp_path / "c.npz", {**content.meta, "version": version}, dict(content.arrays))
    with pytest.raises(ConfigError, match=r"calibration version .*, expected \d+; calibrate again"):
        calibrations.load(tmp_path / "c.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["c.npz"]


def test_what_it_was_made_of_needs_a_reference_that_is_an_image(tmp_path: Path) -> None:
    inputs = Inputs(Sensor(20.0, 30.0, 50.0, "bright"), (FREE,))
    calibration_file.save(tmp_path / "c.npz", painted_calibration(), inputs)
    content, _ = checked_npz.read(str(tmp_path / "c.npz"), "", "")
    arrays = {**content.arrays, "reference_grey": np.zeros(7, np.uint8)}
    written(tmp_path / "c.npz", {**content.meta, "version": 3}, arrays)
    with pytest.raises(ConfigError, match="expected an image in reference_grey; calibrate again"):
        calibrations.load(tmp_path / "c.npz")
