"""The smallest and the largest skins, and pictures of few pixels: the same picture means a dent in
proportion, and arrives at a subscriber.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.painted_sensor import TOUCHED, painted_calibration
from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.library.frame_assembler import FrameAssembler
from tacshade_edge.library.result import Result
from tacshade_edge.sensor.image.white import binarise
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Calibration, Disc, Frame
from tacshade_edge.wire import binary, messages


def received(sensor: Calibration, touched: U8, profile: str = "fast") -> Result:
    """What a subscriber gets of a touched frame after an untouched one."""
    known = with_crc(sensor)
    made = make_reconstructor(known, PROFILES[profile])
    made.step(Frame(0, 0, 0, known.reference_grey))
    result = made.step(Frame(1, 1, 1, touched))
    assembler = FrameAssembler()
    assembler.add("info", messages.encode_info(calibration=known, profile=profile))
    assembler.add("height", binary.encode_height(result, calibration_crc32=known.crc32))
    assembler.add("cloud", binary.encode_cloud(result, calibration_crc32=known.crc32))
    assembler.add("contact", messages.encode_contact(result, fps=60.0))
    found = assembler.take()
    assert found is not None
    return found


def painted_of(radius_mm: float) -> Calibration:
    """The painted sensor of 20 mm in another size."""
    usual = painted_calibration()
    assert usual.geometry.camera_distance_mm is not None
    distance_mm = usual.geometry.camera_distance_mm * radius_mm / usual.geometry.skin_radius_mm
    geometry = replace(usual.geometry, skin_radius_mm=radius_mm, camera_distance_mm=distance_mm)
    return replace(usual, geometry=geometry)


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["fast", "paper"])
@pytest.mark.parametrize("radius_mm", [1.0, 2.0, 200.0, 10_000.0])
def test_a_dent_is_in_proportion_to_the_skin(radius_mm: float, profile: str) -> None:
    usual = received(painted_calibration(), TOUCHED, profile)
    found = received(painted_of(radius_mm), TOUCHED, profile)
    assert len(found.objects) == len(usual.objects) == 1
    assert found.points_mm.shape == usual.points_mm.shape
    scale = radius_mm / 20
    for found_mm, usual_mm in (
        (found.depth_max_mm, usual.depth_max_mm),
        (np.nanmax(found.height_mm), np.nanmax(usual.height_mm)),
    ):
        assert found_mm == pytest.approx(usual_mm * scale, abs=0.001 + 1e-3 * scale)


@pytest.mark.parametrize(
    ("seq", "t_ns", "wall_ns"),
    [
        (2**32 - 2, 10 * 365 * 86_400 * 10**9, 0),  # ten years of uptime, an unset clock
        (2**40, 2**53 - 1, 2**31 * 10**9),  # as 2038 begins
        (2**63, 2**62, 2**64 - 1),
    ],
)
def test_frames_of_any_number_and_time_give_the_same(seq: int, t_ns: int, wall_ns: int) -> None:
    """Slip, drift and settling go by differences of times."""
    sensor = painted_calibration()
    pictures = [sensor.reference_grey, TOUCHED, TOUCHED, sensor.reference_grey, TOUCHED]

    def payloads(seq0: int, t0_ns: int, wall_ns: int) -> list[bytes]:
        made = make_reconstructor(sensor, PROFILES["fast"])
        frames = [
            Frame(seq0 + k, t0_ns + k * 16_666_667, wall_ns, each)
            for k, each in enumerate(pictures)
        ]
        encoded = [binary.encode_height(made.step(each), calibration_crc32=0) for each in frames]
        times = [(m.seq, m.t_ns, m.wall_ns) for m in map(binary.decode, encoded)]
        assert times == [(f.seq % 2**32, f.t_ns, f.wall_ns) for f in frames]
        return [each[binary.HEADER_BYTES :] for each in encoded]

    assert payloads(seq, t_ns, wall_ns) == payloads(0, 0, 0)


@pytest.mark.parametrize("side_px", [16, 17, 24])
def test_a_picture_of_a_few_pixels_has_an_answer(side_px: int) -> None:
    free = np.full((side_px, side_px), 30, np.uint8)
    free[::4, ::4] = free[1::4, ::4] = 200
    touched = free.copy()
    touched[6:10, 6:10] = 200
    usual, middle = painted_calibration(), (side_px - 1) / 2
    sensor = replace(
        usual,
        geometry=replace(usual.geometry, disc=Disc(middle, middle, side_px / 2 - 1)),
        image_height_px=side_px,
        image_width_px=side_px,
        pitch_px=4.0,
        reference_grey=free,
        reference_white=255 * binarise(free, np.ones_like(free), "adaptive", 4.0),
    )
    found = received(sensor, touched)
    assert found.valid or found.reason_code
    assert not received(sensor, free).contact.any()
