from __future__ import annotations

from typing import Any

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.references import REFERENCE_FRAMES, ReferenceCollector
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Frame


def result_depth_mm(calibration: Calibration, image: Any) -> float:
    return make_reconstructor(calibration, PROFILES["fast"]).step(Frame(0, 0, 0, image)).depth_max_mm


def collect(calibration: Calibration, images: list[Any]) -> list[int | Reason]:
    """The number of images that were taken, or why none."""
    outcomes: list[int | Reason] = []
    collector = ReferenceCollector(lambda o: outcomes.append(o if isinstance(o, Reason) else len(o)))
    reconstructor = make_reconstructor(calibration, PROFILES["fast"])
    for seq, image in enumerate(images):
        frame = Frame(seq, 0, 0, image)
        collector.see(frame, reconstructor.step(frame))
    return outcomes


def test_exactly_the_next_frames_are_taken_once(calibration: Calibration, pictures: Any) -> None:
    assert collect(calibration, [pictures.free] * (REFERENCE_FRAMES - 1)) == []
    assert collect(calibration, [pictures.free] * (2 * REFERENCE_FRAMES + 3)) == [REFERENCE_FRAMES]


@pytest.mark.parametrize(
    ("bad", "code", "text"),
    [
        (
            "touched",
            ReasonCode.FRAME_IN_CONTACT,
            "frame 4: found a contact {depth_mm:.2f} mm deep, expected no contact",
        ),
        (
            "black",
            ReasonCode.FRAME_INVALID,
            "frame 4: found an invalid frame (black: mean grey level 0, standard deviation 0.0), "
            "expected a valid frame of an untouched sensor",
        ),
    ],
)
def test_a_touched_or_invalid_frame_spoils_them(
    calibration: Calibration, pictures: Any, bad: str, code: ReasonCode, text: str
) -> None:
    images = [pictures.free] * 4 + [getattr(pictures, bad)] + [pictures.free] * 20
    expected = text.format(depth_mm=result_depth_mm(calibration, pictures.touched))
    assert collect(calibration, images) == [Reason(code, expected)]
