from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from msgspec import Meta

from support.painted_sensor import FREE, painted_calibration
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.inputs import Inputs, StatedSensor
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files import npz
from tacshade_edge.files.npz import Content
from tacshade_edge.sensor.touch.learning import learn
from tacshade_edge.types import (
    Calibration,
    Fit,
    FittedNetwork,
    Geometry,
    ProfileFit,
    RestLimits,
    TouchModel,
)


def assert_same(one: Any, other: Any) -> None:
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b, field.name


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> Content:
    path = tmp_path_factory.mktemp("calibration") / "cal.npz"
    calibration_file.save(path, painted_calibration())
    return npz.read(str(path), "calibration", "")


def test_what_is_stored_comes_back(tmp_path: Path) -> None:
    for k, calibration in enumerate(
        (
            replace(painted_calibration(), error_scales={"fast": 1.25, "balanced": 0.5}),
            replace(painted_calibration(), rest={"fast": RestLimits(60, 1e-4, 0.02, -0.001, 0.3)}),
            replace(painted_calibration(), flange_T_sensor=(1.5, -2.0, 30.0, 0.6, 0.0, 0.8, 0.0)),
            replace(
                painted_calibration(),
                geometry=replace(painted_calibration().geometry, camera_distance_mm=None),
            ),
        )
    ):
        path = tmp_path / f"{k}.npz"
        saved = calibration_file.save(path, calibration)
        assert saved.crc32 != 0
        loaded = calibration_file.load(path)
        assert_same(loaded, saved)
        assert_same(replace(loaded, crc32=0), replace(calibration, crc32=0))
        assert not loaded.reference_white.flags.writeable


def test_the_fit_is_stored_under_flat_keys(tmp_path: Path) -> None:
    """As in every file of this version, so that old files load and keep their checksum."""
    flat = {
        "presses": 20.0,
        "agreement_mae_mm": 0.1,
        "position_mae_mm": 0.5,
        "accurate_presses": 19.0,
        "accurate_depth_mae_mm": 0.2,
        "accurate_depth_worst_mm": 0.6,
    }
    fit = Fit(20, 0.1, 0.5, {"accurate": ProfileFit(19, 0.2, 0.6)})
    for stored, expected in ((fit, flat), (None, {})):
        path = tmp_path / "cal.npz"
        saved = calibration_file.save(path, replace(painted_calibration(), fit=stored))
        with np.load(path) as npz:
            assert json.loads(npz["meta"].tobytes())["fit"] == expected
        assert calibration_file.load(path).fit == stored
        assert calibration_file.load(path).crc32 == saved.crc32


def test_what_is_no_calibration_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", height_mm=np.zeros(3))
    np.savez(tmp_path / "pickled.npz", meta=np.array([{"a": 1}], dtype=object))
    for name in ("other.npz", "pickled.npz", "none.npz", "."):
        with pytest.raises(ConfigError) as refusal:
            calibration_file.load(tmp_path / name)
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("version", [calibration_file.OLDEST, calibration_file.VERSION - 1])
def test_one_fitted_to_the_networks_before_is_read_without_its_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, version: int
) -> None:
    fitted = replace(painted_calibration(), factors={"fast": 1.2, "accurate": 0.9})
    assert fitted.fit is not None
    monkeypatch.setattr(calibration_file, "VERSION", version)
    calibration_file.save(tmp_path / "old.npz", fitted)
    calibration_file.save(tmp_path / "unfitted.npz", replace(fitted, factors={}, fit=None))
    monkeypatch.undo()
    loaded = calibration_file.load(tmp_path / "old.npz")
    assert (loaded.factors, loaded.fit) == ({}, None)
    assert (loaded.geometry, loaded.crc32 != 0) == (fitted.geometry, True)
    np.testing.assert_array_equal(loaded.reference_white, fitted.reference_white)
    (said,) = caplog.messages
    assert said.endswith(
        "old.npz: ignoring the calibration's fit, which belongs to older networks; calibrate again"
    )
    caplog.clear()
    assert calibration_file.load(tmp_path / "unfitted.npz").factors == {}
    assert not caplog.messages


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "cal.npz"
    old = calibration_file.save(path, painted_calibration())

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DeviceError, match="No space left"):
        calibration_file.save(path, replace(painted_calibration(), alpha=16.0))
    assert_same(calibration_file.load(path), old)
    assert os.listdir(tmp_path) == ["cal.npz"]
    with pytest.raises(
        DeviceError, match=r"none/cal\.npz: cannot write the calibration: No such file"
    ):
        calibration_file.save(tmp_path / "none" / "cal.npz", old)


@dataclass(frozen=True, eq=False)
class Warmer(Calibration):
    """A calibration with a number more, written in one place."""

    warmth: Annotated[float, Meta(ge=0, le=9)] = 1.0


def test_a_number_more_is_a_field_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Older files lack it and keep their checksum; its bounds hold for what a file says."""
    monkeypatch.setattr(calibration_file, "Calibration", Warmer)
    plain = {
        field.name: getattr(painted_calibration(), field.name) for field in fields(Calibration)
    }
    for warmth in (1.0, 2.5):
        saved = calibration_file.save(tmp_path / "c.npz", Warmer(**plain, warmth=warmth))
        assert (saved.crc32 == calibration_file.with_crc(painted_calibration()).crc32) == (
            warmth == 1.0
        )
        loaded: Any = calibration_file.load(tmp_path / "c.npz")
        assert (loaded.warmth, loaded.crc32) == (warmth, saved.crc32)
    content = npz.read(str(tmp_path / "c.npz"), "", "")
    (tmp_path / "c.npz").write_bytes(
        Content({**content.meta, "warmth": 10.0}, content.arrays).packed()
    )
    with pytest.raises(ConfigError, match="warmth"):
        calibration_file.load(tmp_path / "c.npz")


def test_a_pad_is_stored_and_a_dome_keeps_its_checksum(tmp_path: Path) -> None:
    dome = painted_calibration()
    flat = replace(dome, geometry=Geometry(math.inf, 27.0, 0.0, dome.geometry.disc, 15.0))
    saved = calibration_file.save(tmp_path / "pad.npz", flat)
    loaded = calibration_file.load(tmp_path / "pad.npz")
    assert (loaded.geometry, loaded.crc32) == (flat.geometry, saved.crc32)
    calibration_file.save(tmp_path / "dome.npz", dome)
    assert "pad_radius_mm" not in npz.read(str(tmp_path / "dome.npz"), "", "").meta


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pad_radius_mm": None}, "skin_radius_mm"),
        ({"skin_radius_mm": 20.0}, "not a pad's"),
        ({"visible_half_angle_deg": 50.0}, "not a pad's"),
        ({"pad_radius_mm": 0.0}, "pad_radius_mm"),
        ({"pad_radius_mm": math.nan}, "pad_radius_mm"),
        ({"camera_distance_mm": -1.0}, "camera_distance_mm"),
        ({"camera_distance_mm": math.inf}, "camera_distance_mm"),
    ],
)
def test_a_pad_that_no_sensor_has_is_refused(changes: dict[str, Any], said: str) -> None:
    dome = painted_calibration()
    flat = Geometry(math.inf, 27.0, 0.0, dome.geometry.disc, 15.0)
    with pytest.raises(ValueError, match=said):
        replace(dome, geometry=replace(flat, **changes))


_POSE = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
_FIT = {"presses": 1.0, "agreement_mae_mm": 0.1, "position_mae_mm": 0.1}
_WRONG: list[tuple[str, object]] = [
    *(("polarity", value) for value in ("x", None)),
    *(("skin_radius_mm", value) for value in ("20", None, True, [], math.nan, 1e-300)),
    *((name, 1e-300) for name in ("radius_px", "visible_half_angle_deg")),
    *(("factors", value) for value in ([], None, {"fast": "1"}, {"fast": math.nan})),
    *(("error_scales", value) for value in ({"fast": 0.0}, {"fast": 1e9})),
    *(("fit", value) for value in ([], {"presses": 1.0}, {**_FIT, "presses": math.inf})),
    ("fit", {**_FIT, "fast_depth_mae_mm": 0.1}),
    *(
        ("flange_T_sensor", value)
        for value in (None, _POSE[:6], [0.0] * 7, [1e300] * 7, [math.nan, *_POSE[1:]])
    ),
    *(("reference_white", np.zeros(shape, np.uint8)) for shape in ((), (0, 0), (2, 2, 3))),
    ("reference_grey", np.zeros((480, 640), np.float32)),
]


def written(path: Path, meta: dict[str, Any], arrays: dict[str, Any]) -> Path:
    path.write_bytes(Content(meta, arrays).packed())
    return path


@pytest.mark.parametrize(("name", "value"), _WRONG)
def test_a_right_checksum_of_a_wrong_value_is_refused(
    tmp_path: Path, content: Content, name: str, value: object
) -> None:
    meta, arrays = dict(content.meta), dict(content.arrays)
    (arrays if isinstance(value, np.ndarray) else meta)[name] = value
    path = written(tmp_path / "odd.npz", meta, arrays)
    with pytest.raises(ConfigError, match=r"odd\.npz: .*; calibrate again") as refusal:
        calibration_file.load(path)
    assert "\n" not in str(refusal.value)


def test_nothing_may_be_missing(tmp_path: Path, content: Content) -> None:
    for name in content.meta:
        meta = {key: value for key, value in content.meta.items() if key != name}
        with pytest.raises(ConfigError, match=name):
            calibration_file.load(written(tmp_path / "odd.npz", meta, dict(content.arrays)))
    calibration_file.load(written(tmp_path / "whole.npz", dict(content.meta), dict(content.arrays)))
    later = {**content.meta, "version": calibration_file.VERSION + 1}
    with pytest.raises(
        ConfigError,
        match=r"later\.npz: found calibration version \d+, expected \d+; calibrate again",
    ):
        calibration_file.load(written(tmp_path / "later.npz", later, dict(content.arrays)))


@pytest.mark.parametrize("version", ["../../x\x1b[31m" + "a" * 5000, 6.5, True])
def test_a_version_that_is_no_number_names_no_file(tmp_path: Path, version: object) -> None:
    inputs = Inputs(StatedSensor(20.0, 30.0, 50.0, "bright"), (FREE,))
    calibration_file.save(tmp_path / "c.npz", painted_calibration(), inputs)
    content = npz.read(str(tmp_path / "c.npz"), "", "")
    written(tmp_path / "c.npz", {**content.meta, "version": version}, dict(content.arrays))
    with pytest.raises(
        ConfigError, match=r"calibration version .*, expected \d+; calibrate again"
    ) as refusal:
        loading.load(tmp_path / "c.npz")
    assert len(str(refusal.value)) < 500
    assert str(refusal.value).isprintable()
    assert [path.name for path in tmp_path.iterdir()] == ["c.npz"]


FITTED = FittedNetwork("a1", np.arange(5, dtype=np.float32), 8, error_mm=0.2, shipped_error_mm=0.4)
FEATURES = np.random.default_rng(0).normal(size=(60, 20)).astype(np.float32)


@pytest.fixture(scope="module")
def model() -> TouchModel:
    labels = FEATURES[:, :2].astype(np.float64)
    found = learn(
        FEATURES,
        FEATURES[:, :7],
        np.ones(60),
        ("depth_mm", "force_z_n"),
        labels,
        np.arange(60),
        "ab",
    ).model
    assert found is not None
    return found


def test_networks_and_models_come_back_and_count_in_the_checksum(
    tmp_path: Path, model: TouchModel
) -> None:
    path, plain = tmp_path / "c.npz", painted_calibration()
    for fitted in (FITTED, replace(FITTED, factor=1.1, error_scale=1.5)):
        saved = calibration_file.save(
            path, replace(plain, fitted={"fast": fitted}, touch={"fast": model})
        )
        loaded = calibration_file.load(path)
        assert loaded.crc32 == saved.crc32 != calibration_file.with_crc(plain).crc32
        for found in (loaded.fitted, calibration_file.fitted_in(path)):
            assert_same(found["fast"], fitted)
        for models in (loaded.touch, calibration_file.touch_in(path)):
            assert_same(models["fast"], model)
    calibration_file.save(path, plain)
    assert (calibration_file.fitted_in(path), calibration_file.touch_in(path)) == ({}, {})


@pytest.mark.parametrize(
    ("key", "damage", "message"),
    [
        ("fitted", {"more": 1}, "unknown field"),
        ("fitted", {"error_scale": 0.0}, "Expected"),
        ("fitted", {"factor": -1.0}, "Expected"),
        ("touch", {"names": ["depth_mm", "colour"]}, "other quantities"),
        ("touch", {"names": ["depth_mm"]}, "does not fit"),
        ("touch", {"shapes": {}}, "other arrays"),
        ("touch", {"width": 0.0}, "Expected"),
        ("touch", {"more": 1}, "unknown field"),
    ],
)
def test_a_network_or_model_that_cannot_be_is_refused(
    tmp_path: Path, model: TouchModel, key: str, damage: dict[str, object], message: str
) -> None:
    path = tmp_path / "c.npz"
    calibration_file.save(
        path, replace(painted_calibration(), fitted={"fast": FITTED}, touch={"fast": model})
    )
    content = npz.read(str(path), "", "")
    about = {"fast": {**content.meta[key]["fast"], **damage}}
    written(path, {**content.meta, key: about}, dict(content.arrays))
    for read in (
        calibration_file.load,
        calibration_file.fitted_in if key == "fitted" else calibration_file.touch_in,
    ):
        with pytest.raises(ConfigError, match=f"{message}.*; calibrate again"):
            read(path)


def test_damaged_arrays_of_a_network_or_model_are_refused(
    tmp_path: Path, model: TouchModel
) -> None:
    path = tmp_path / "c.npz"
    calibration_file.save(
        path, replace(painted_calibration(), fitted={"fast": FITTED}, touch={"fast": model})
    )
    content = npz.read(str(path), "", "")
    for name in [name for name in content.arrays if name.startswith(("fitted", "touch"))]:
        array = content.arrays[name]
        for other, message in (
            (array[:0], "said to be|no fitted weights"),
            (array.astype(np.float64), "said to be|Expected an array"),
            (np.full_like(array, np.nan), "not finite"),
        ):
            written(path, dict(content.meta), {**content.arrays, name: other})
            with pytest.raises(ConfigError, match=message):
                calibration_file.load(path)
        written(
            path,
            dict(content.meta),
            {key: value for key, value in content.arrays.items() if key != name},
        )
        with pytest.raises(ConfigError, match=r"said to be|no fitted weights"):
            calibration_file.load(path)
