from __future__ import annotations

from typing import Any

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.reference import REFERENCE_FRAMES, ReferenceCollector
from tacshade_edge.devices.weights.network import make_reconstructor
from tacshade_edge.types import Calibration, Frame


def result_depth_mm(calibration: Calibration, image: Any) -> float:
    return make_reconstructor(calibration, PROFILES["fast"]).step(Frame(0, 0, 0, image)).depth_max_mm


def collect(calibration: Calibration, images: list[Any]) -> list[tuple[int, str]]:
    told: list[tuple[int, str]] = []
    collector = ReferenceCollector(lambda taken, reason: told.append((len(taken), reason)))
    reconstructor = make_reconstructor(calibration, PROFILES["fast"])
    for seq, image in enumerate(images):
        frame = Frame(seq, 0, 0, image)
        collector.watch(frame, reconstructor.step(frame))
    return told


def test_exactly_the_next_frames_are_taken_once(calibration: Calibration, pictures: Any) -> None:
    assert collect(calibration, [pictures.free] * (REFERENCE_FRAMES - 1)) == []
    assert collect(calibration, [pictures.free] * (2 * REFERENCE_FRAMES + 3)) == [(REFERENCE_FRAMES, "")]


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ("touched", "frame 4 shows contact {depth_mm:.2f} mm deep, expected nothing to touch the sensor"),
        ("black", "frame 4 is invalid (black: mean grey 0, deviation 0.0), expected an untouched sensor in view"),
    ],
)
def test_a_touched_or_invalid_frame_spoils_them(calibration: Calibration, pictures: Any, bad: str, said: str) -> None:
    images = [pictures.free] * 4 + [getattr(pictures, bad)] + [pictures.free] * 20
    assert collect(calibration, images) == [(0, said.format(depth_mm=result_depth_mm(calibration, pictures.touched)))]
