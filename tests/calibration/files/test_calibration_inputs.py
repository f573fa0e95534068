from __future__ import annotations

import zipfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from support.painted_sensor import painted_calibration
from tacshade_edge.calibration.files import calibration_file, reference_file
from tacshade_edge.calibration.files.calibration_file import (
    IMAGES,
    TRIANGLES,
    pack_inputs,
    unpack_inputs,
    with_crc,
)
from tacshade_edge.calibration.files.reference_file import (
    LearntLimits,
    Source,
    StoredReference,
    belongs_to,
    limited,
    path_beside,
)
from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.inputs import Inputs, KnownPress, StatedSensor
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files import npz
from tacshade_edge.files.npz import Content
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import U8, RestLimits

SHAPE = (12, 16)
SENSOR = StatedSensor(
    20.0,
    None,
    50.0,
    "dark",
    flange_T_sensor=(1.0, 2.0, 3.0, 0.6, 0.0, 0.8, 0.0),
    print_mm={"pin_length_mm": 3.1},
)


def image(seed: int) -> U8:
    return np.random.default_rng(seed).integers(0, 256, SHAPE, dtype=np.uint8)


def solid(name: str, seed: int, triangles: int) -> Indenter:
    return Indenter(name, np.random.default_rng(seed).random((triangles, 3, 3)))


CUBE, CONE = solid("cube", 1, 12), solid("cone", 2, 5)
PRESSES = (
    KnownPress("P.csv:2: a.png", image(3), 4.0, 1.5, None, None),
    KnownPress("P.csv:3: b.png", image(4), 0.0, 2.0, 1.0, -2.0, CONE, 10.0, -5.0, 3.0),
    KnownPress("P.csv:4: c.png", image(5), 0.0, 2.5, 0.0, 0.0, CUBE),
    KnownPress("P.csv:5: d.png", image(6), 0.0, 0.5, 0.0, 0.0, CONE),
)
INPUTS = Inputs(SENSOR, (image(7), image(8)), PRESSES, (image(9),))


def read(
    meta: dict[str, object], arrays: dict[str, object], shape: tuple[int, int] = SHAPE
) -> Inputs:
    found = unpack_inputs({"inputs": meta}, {**arrays, "reference_grey": np.zeros(shape, np.uint8)})
    assert found is not None
    return found


@pytest.mark.parametrize("inputs", [INPUTS, Inputs(SENSOR, (image(7),))])
def test_what_is_packed_comes_back(inputs: Inputs) -> None:
    packed = pack_inputs(inputs)
    assert packed is not None
    assert set(packed[1]) == {IMAGES, TRIANGLES}
    found = read(*packed)
    assert found.sensor == inputs.sensor
    for name in ("references", "renewed"):
        np.testing.assert_array_equal(getattr(found, name), getattr(inputs, name))
    for press, true in zip(found.presses, inputs.presses, strict=True):
        np.testing.assert_array_equal(press.image, true.image)
        for name in (
            "name",
            "radius_mm",
            "depth_mm",
            "x_mm",
            "y_mm",
            "yaw_deg",
            "tilt_x_deg",
            "tilt_y_deg",
        ):
            assert getattr(press, name) == getattr(true, name)
        assert (press.indenter is None) == (true.indenter is None)
        if press.indenter is not None and true.indenter is not None:
            assert press.indenter.name == true.indenter.name
            np.testing.assert_array_equal(press.indenter.triangles_mm, true.indenter.triangles_mm)


def test_an_indenter_is_kept_once_and_too_large_images_are_not_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    packed = pack_inputs(INPUTS)
    assert packed is not None
    assert len(packed[1][TRIANGLES]) == 17
    found = read(*packed)
    assert found.presses[1].indenter is found.presses[3].indenter
    monkeypatch.setattr(calibration_file, "INPUT_BYTES_MAX", 100)
    assert pack_inputs(INPUTS) is None


@pytest.mark.parametrize(
    "damage",
    [
        {"references": [10, 20]},
        {"pressed": []},
        {"indenters": [{"name": "cube", "triangles": 12}]},
        {"sensor": {"skin_radius_mm": "wide"}},
        {"more": 1},
    ],
)
def test_what_cannot_be_is_refused(damage: dict[str, object]) -> None:
    packed = pack_inputs(INPUTS)
    assert packed is not None
    with pytest.raises(ValueError, match=r"[Ee]xpected|unknown field"):
        read({**packed[0], **damage}, packed[1])


def test_images_of_another_size_are_refused_before_they_are_decoded() -> None:
    packed = pack_inputs(INPUTS)
    assert packed is not None
    with pytest.raises(ValueError, match="expected a grey PNG image of 17x12 px"):
        read(*packed, (12, 17))
    blank = packed[1][IMAGES].copy()
    blank[40:] = 0
    with pytest.raises(ValueError, match="expected a grey PNG"):
        read(packed[0], {**packed[1], IMAGES: blank})


CALIBRATED = painted_calibration()
ARRAYS = {
    "reference_white": CALIBRATED.reference_white,
    "reference_grey": CALIBRATED.reference_grey // 2,
}
TAKEN = StoredReference(
    with_crc(replace(CALIBRATED, **ARRAYS, noise_grey=0.75)), 1_700_000_000_123_456_789
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return path_beside(tmp_path / "calibration.npz")


def test_what_is_stored_comes_back_and_nothing_where_nothing_is(path: Path) -> None:
    assert path.name == "calibration.reference.npz"
    assert reference_file.load(path, CALIBRATED) is None
    reference_file.save(path, CALIBRATED, TAKEN)
    stored = reference_file.load(path, CALIBRATED)
    assert stored is not None
    assert stored.wall_ns == TAKEN.wall_ns
    assert stored.calibration.crc32 == TAKEN.calibration.crc32 != CALIBRATED.crc32
    assert stored.calibration.noise_grey == 0.75
    np.testing.assert_array_equal(
        stored.calibration.reference_grey, TAKEN.calibration.reference_grey
    )
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_it_belongs_to_a_calibration_of_the_same_images(path: Path) -> None:
    reference_file.save(path, CALIBRATED, TAKEN)
    with pytest.raises(
        ConfigError, match=f"{path}: the stored reference belongs to another calibration"
    ) as caught:
        reference_file.load(
            path, with_crc(replace(CALIBRATED, reference_grey=CALIBRATED.reference_grey // 2))
        )
    assert caught.value.code is ReasonCode.CALIBRATION_CHANGED
    stored = reference_file.load(
        path, with_crc(replace(CALIBRATED, alpha=16.0, factors={"fast": 1.1}))
    )
    assert stored is not None
    assert stored.calibration.factors == {"fast": 1.1}
    np.testing.assert_array_equal(
        stored.calibration.reference_grey, TAKEN.calibration.reference_grey
    )


LIMITS = RestLimits(120, 1e-4, height_mm=0.03, local_change=0.01, changed_part=0.3)
LEARNT = LearntLimits(now=LIMITS, first=replace(LIMITS, height_mm=0.02))


@pytest.mark.parametrize("source", ["calibration", "request"])
def test_limits_that_were_learnt_come_back_for_the_very_same_calibration(
    path: Path, source: Source
) -> None:
    own = with_crc(replace(CALIBRATED, rest={"accurate": LIMITS}))
    limits = {"fast": LEARNT, "accurate": replace(LEARNT, first=LIMITS)}
    kept = limited(own if source == "calibration" else TAKEN.calibration, limits)
    reference_file.save(path, own, StoredReference(kept, 5, source, limits))
    stored = reference_file.load(path, own)
    assert stored is not None
    assert (stored.source, stored.limits, stored.wall_ns) == (source, limits, 5)
    assert stored.calibration.rest == {"fast": LIMITS, "accurate": LIMITS}
    assert stored.calibration.crc32 == kept.crc32
    # Another network finds other heights in the same images.
    refitted = with_crc(replace(own, factors={"fast": 1.1}))
    bare = reference_file.load(path, refitted)
    assert bare is not None
    assert (bare.limits, bare.calibration.rest) == ({}, own.rest)


def _with_height(height_mm: float) -> dict[str, object]:
    stored = asdict(LEARNT)
    stored["now"]["height_mm"] = height_mm
    return stored


META = {"version": 2, "belongs_to": belongs_to(CALIBRATED), "wall_ns": 5, "noise_grey": 0.5}


@pytest.mark.parametrize(
    ("meta", "arrays"),
    [
        ({**META, "version": 1}, ARRAYS),
        ({**META, "noise_grey": float("nan")}, ARRAYS),
        ({**META, "wall_ns": "now"}, ARRAYS),
        (META, {}),
        ({**META, "source": "guess"}, ARRAYS),
        ({**META, "limits": {"fast": 3}}, ARRAYS),
        ({**META, "limits": {"fast": {"now": asdict(LIMITS)}}}, ARRAYS),
        ({**META, "limits": {"fast": _with_height(-1.0)}}, ARRAYS),
        ({**META, "limits": {"fast": _with_height(float("nan"))}}, ARRAYS),
        (META, {**ARRAYS, "more": np.zeros(3)}),
        (META, {**ARRAYS, "reference_grey": ARRAYS["reference_grey"][:-1]}),
        (META, {**ARRAYS, "reference_grey": ARRAYS["reference_grey"].astype(np.float32)}),
    ],
)
def test_what_cannot_be_one_is_refused_in_one_line(
    path: Path, meta: dict[str, object], arrays: dict[str, object]
) -> None:
    path.write_bytes(Content(meta, arrays).packed())
    with pytest.raises(ConfigError, match=f"{path}: .*take a new ") as caught:
        reference_file.load(path, CALIBRATED)
    assert "\n" not in str(caught.value)


def test_other_files_and_none_that_can_be_read(path: Path) -> None:
    calibration_file.save(path, CALIBRATED)
    with pytest.raises(ConfigError, match="found a calibration; expected a stored reference"):
        reference_file.load(path, CALIBRATED)
    path.write_bytes(b"PK\x03\x04" * 9)
    with pytest.raises(ConfigError, match="reference"):
        reference_file.load(path, CALIBRATED)
    path.unlink()
    path.mkdir()
    with pytest.raises(ConfigError, match="cannot read the stored reference"):
        reference_file.load(path, CALIBRATED)
    with pytest.raises(DeviceError, match="cannot write it: No such file or directory") as caught:
        reference_file.save(path.parent / "gone" / path.name, CALIBRATED, TAKEN)
    assert caught.value.code is ReasonCode.DISK


def test_a_calibration_is_never_larger_than_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Large references or solids take the room of images that would not be too many alone."""
    calibration, path = painted_calibration(), tmp_path / "c.npz"
    calibration_file.save(path, calibration)
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    inputs = Inputs(SENSOR, (calibration.reference_grey,), ())
    monkeypatch.setattr(npz, "BYTES_MAX", size + 1000)
    stored = calibration_file.save(path, calibration, inputs)
    assert "too large to store" in caplog.text
    assert calibration_file.load(path).crc32 == stored.crc32
    assert calibration_file.inputs_in(path) is None
    monkeypatch.setattr(npz, "BYTES_MAX", size + 100_000)
    calibration_file.save(path, calibration, inputs)
    assert calibration_file.inputs_in(path) is not None
