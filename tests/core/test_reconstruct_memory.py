"""What a frame allocates once everything is warm."""

from __future__ import annotations

import gc
import tracemalloc

import pytest
from support.calibrated_sensor import FULL, pressed, reconstructor, unloaded

from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.types import Frame, Reconstruction

pytestmark = pytest.mark.slow

# NumPy's arrays are seen, and OpenCV's where it returns them; what OpenCV frees within a call is not.
IMAGE_BYTES = FULL.image_height_px * FULL.image_width_px


def peak_bytes(made: Reconstructor, frame: Frame) -> tuple[Reconstruction, int]:
    """A step's result, and the most that it held at a time beyond what was there before."""
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    result = made.step(frame)
    return result, tracemalloc.get_traced_memory()[1] - before


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_a_frame_allocates_no_image_and_leaves_nothing_behind(profile: str) -> None:
    made = reconstructor(profile, FULL, 0)
    contact = [Frame(i, 0, 0, pressed("ball", depth_mm, FULL).image) for i, depth_mm in enumerate((1.0, 2.0))]
    frames = [*contact, Frame(2, 0, 0, unloaded(FULL))]
    for frame in frames:
        made.step(frame)
    gc.collect()
    tracemalloc.start()
    try:
        for frame in frames:
            result, peak = peak_bytes(made, frame)
            assert (result.valid, result.contact) == (True, frame.seq < len(contact))
            parts = (result.height.height_mm, result.height.contact, result.cloud.points_mm, result.cloud.labels)
            assert result.shear_mm is not None
            assert result.sigma_mm is not None
            parts = (*parts, result.shear_mm, result.sigma_mm)
            own = sum(part.nbytes for part in parts) if result.contact else 0
            assert peak - own < IMAGE_BYTES
        del result, parts
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(10):
            for frame in frames:
                made.step(frame)
        gc.collect()  # ONNX Runtime leaves a small cycle with each run
        assert tracemalloc.get_traced_memory()[0] - before < IMAGE_BYTES / 10
    finally:
        tracemalloc.stop()
