from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import Inputs, KnownPress, Sensor
from tacshade_edge.storage.calibration import calibration_inputs
from tacshade_edge.storage.calibration.calibration_inputs import IMAGES, TRIANGLES, pack, unpack
from tacshade_edge.types import U8

SHAPE = (12, 16)
SENSOR = Sensor(
    20.0, None, 50.0, "dark", flange_T_sensor=(1.0, 2.0, 3.0, 0.6, 0.0, 0.8, 0.0), print_mm={"pin_length_mm": 3.1}
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


def read(meta: dict[str, object], arrays: dict[str, object], shape: tuple[int, int] = SHAPE) -> Inputs:
    found = unpack({"inputs": meta}, {**arrays, "reference_grey": np.zeros(shape, np.uint8)})
    assert found is not None
    return found


@pytest.mark.parametrize("inputs", [INPUTS, Inputs(SENSOR, (image(7),))])
def test_what_is_packed_comes_back(inputs: Inputs) -> None:
    packed = pack(inputs)
    assert packed is not None
    assert set(packed[1]) == {IMAGES, TRIANGLES}
    found = read(*packed)
    assert found.sensor == inputs.sensor
    for name in ("references", "renewed"):
        np.testing.assert_array_equal(getattr(found, name), getattr(inputs, name))
    for press, true in zip(found.presses, inputs.presses, strict=True):
        np.testing.assert_array_equal(press.image, true.image)
        for name in ("name", "radius_mm", "depth_mm", "x_mm", "y_mm", "yaw_deg", "tilt_x_deg", "tilt_y_deg"):
            assert getattr(press, name) == getattr(true, name)
        assert (press.indenter is None) == (true.indenter is None)
        if press.indenter is not None and true.indenter is not None:
            assert press.indenter.name == true.indenter.name
            np.testing.assert_array_equal(press.indenter.triangles_mm, true.indenter.triangles_mm)


def test_an_indenter_is_kept_once() -> None:
    packed = pack(INPUTS)
    assert packed is not None
    assert len(packed[1][TRIANGLES]) == 17
    found = read(*packed)
    assert found.presses[1].indenter is found.presses[3].indenter


def test_too_large_images_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration_inputs, "BYTES_MAX", 100)
    assert pack(INPUTS) is None


@pytest.mark.parametrize(
    "damage",
    [
        {"references": [10, 20]},
        {"references": [-1, 1]},
        {"pressed": []},
        {"indenters": [{"name": "cube", "triangles": 12}]},
        {"presses": "none"},
        {"sensor": {"skin_radius_mm": "wide"}},
        {"more": 1},
    ],
)
def test_what_cannot_be_is_refused(damage: dict[str, object]) -> None:
    packed = pack(INPUTS)
    assert packed is not None
    with pytest.raises(ValueError, match=r"[Ee]xpected|unknown field"):
        read({**packed[0], **damage}, packed[1])


def test_images_of_another_size_are_refused_before_they_are_decoded() -> None:
    packed = pack(INPUTS)
    assert packed is not None
    with pytest.raises(ValueError, match="expected a grey PNG image of 17x12 px"):
        read(*packed, (12, 17))
    wide = packed[1][IMAGES].copy()
    wide[16:20] = (0, 1, 0, 0)
    with pytest.raises(ValueError, match="expected a grey PNG"):
        read(packed[0], {**packed[1], IMAGES: wide})
    blank = packed[1][IMAGES].copy()
    blank[40:] = 0
    with pytest.raises(ValueError, match="expected a grey PNG"):
        read(packed[0], {**packed[1], IMAGES: blank})


@pytest.mark.parametrize("name", [IMAGES, TRIANGLES])
@pytest.mark.parametrize(
    "array", [np.zeros(()), np.zeros(3), np.zeros((17, 3, 3), np.float32), np.full((17, 3, 3), np.nan)]
)
def test_other_arrays_are_refused(name: str, array: np.ndarray) -> None:
    packed = pack(INPUTS)
    assert packed is not None
    with pytest.raises(ValueError, match="expected"):
        read(packed[0], {**packed[1], name: array})
