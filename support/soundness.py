"""What must hold of every reconstruction, whatever the frame was."""

from __future__ import annotations

import json
import math

import numpy as np

from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame, Reconstruction
from tacshade_edge.wire import binary, messages


def everything(result: Reconstruction) -> tuple[object, ...]:
    """All that a result says, bit for bit."""
    height, cloud = result.height, result.cloud
    arrays = (
        height.height_mm,
        height.contact,
        cloud.points_mm,
        cloud.labels,
        result.shear_mm,
        result.untrusted,
    )
    said = (
        result.valid,
        result.reason,
        result.contact,
        result.saturated,
        result.degraded,
        result.objects,
    )
    return (
        *said,
        result.volume_mm3,
        result.repaired_px,
        *(a if a is None else a.tobytes() for a in arrays),
    )


def sound_step(made: Reconstructor, image: U8) -> Reconstruction:
    """One step, looked at; and a second one that gives the same."""
    image = np.ascontiguousarray(image)
    before = image.tobytes()
    result = made.step(Frame(0, 0, 0, image))
    assert image.tobytes() == before
    assert_sound(result, made)
    assert everything(made.step(Frame(0, 0, 0, image))) == everything(result)
    return result


def assert_sound(result: Reconstruction, made: Reconstructor) -> None:
    """Finite, within the skin, in agreement with itself, and fit for the wire."""
    inside, r_mm = made.rays.inside, made.calibration.geometry.skin_radius_mm
    height, touched = result.height.height_mm, result.height.contact
    reach_mm = r_mm * (1 + 1e-5)
    assert height.dtype == np.float32
    np.testing.assert_array_equal(np.isnan(height), ~inside)
    assert (height[inside] >= 0).all()
    assert (height[inside] <= reach_mm).all()
    points, labels = result.cloud.points_mm, result.cloud.labels
    assert np.isfinite(points).all()
    assert (np.linalg.norm(points.astype(np.float64), axis=1) <= reach_mm).all()
    assert (
        set(labels.tolist())
        == {o.label for o in result.objects}
        == set(range(1, len(result.objects) + 1))
    )
    assert int(touched.sum()) == len(points) == len(labels)
    assert not (touched & ~inside).any()
    assert result.contact == bool(result.objects)
    assert 0 <= result.volume_mm3 < math.inf
    assert 0 <= result.repaired_px <= 2 * height.size
    for touch in result.objects:
        figures = (*touch.centroid_mm, *touch.extent_mm, touch.depth_max_mm, touch.area_mm2)
        assert all(map(math.isfinite, figures)), touch
        assert math.hypot(*touch.centroid_mm) <= reach_mm
        assert all(0 <= extent <= 2 * reach_mm for extent in touch.extent_mm)
        assert 0 <= touch.depth_max_mm <= reach_mm
        assert touch.area_mm2 > 0
    if result.shear_mm is not None:
        np.testing.assert_array_equal(
            np.isnan(result.shear_mm), np.repeat(~inside[..., None], 2, axis=2)
        )
    if not result.contact:
        assert not height[inside].any()
        assert result.volume_mm3 == 0
    if not result.valid:
        assert result.reason
        assert not result.contact
    _assert_wire(result)


def _assert_wire(result: Reconstruction) -> None:
    height = binary.decode(binary.encode_height(result, calibration_crc32=1))
    assert isinstance(height, binary.HeightMessage)
    # Rounded, and neither wrapped nor cut.
    scale_mm = binary.scale_of(result.height.height_mm)
    np.testing.assert_allclose(
        height.height_mm, result.height.height_mm, atol=0.6 * scale_mm, equal_nan=True
    )
    cloud = binary.decode(binary.encode_cloud(result, calibration_crc32=1))
    assert isinstance(cloud, binary.CloudMessage)
    assert cloud.points_mm.tobytes() == result.cloud.points_mm.tobytes()
    said = json.loads(messages.encode_contact(result, fps=0.0))
    nothing = {key for key, value in said.items() if value is None}
    sheared = result.contact and result.shear_mm is not None
    unknown = {"slip", "slip_mm_s"} | (set() if result.contact else {"x_mm", "y_mm"})
    if not result.valid:
        unknown |= {"contact", "touched", "objects", "depth_max_mm", "area_mm2", "volume_mm3"}
    assert nothing - {"twist_deg"} == unknown | (set() if sheared else {"shear_x_mm", "shear_y_mm"})
    if result.shear_mm is not None:
        shear = binary.decode(binary.encode_shear(result, calibration_crc32=1))
        assert isinstance(shear, binary.ShearMessage)
        expected_mm = np.clip(result.shear_mm, -32.767, 32.767)
        np.testing.assert_allclose(shear.shear_mm, expected_mm, atol=0.0006, equal_nan=True)


def assert_nothing(result: Reconstruction, inside: np.ndarray) -> None:
    """Exactly 0 inside the disc, NaN outside, no object."""
    height = result.height.height_mm
    assert not result.contact
    assert (height[inside] == 0).all()
    assert np.isnan(height[~inside]).all()
    assert not result.height.contact.any()
    assert result.cloud.points_mm.shape == (0, 3)
    assert result.cloud.labels.shape == (0,)
    assert (result.objects, result.volume_mm3, result.depth_max_mm) == ((), 0.0, 0.0)


def always_asked(calibration: Calibration, profile: str) -> Reconstructor:
    """With a gate that opens at any change, so that every frame
    that passes the check reaches the solver.
    """
    made = make_reconstructor(calibration, PROFILES[profile])
    made.gate_part = -1.0
    return made
