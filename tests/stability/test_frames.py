"""Frames that no sensor makes, through every profile:
finite, inside the skin, the same twice, fit for the wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.built_sensor import built_calibration, marked
from support.examples import examples
from support.extremes import EXTREME_IMAGES, Maker, makers
from support.soundness import always_asked, everything, sound_step
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Binarisation, Calibration, Disc, Frame, Polarity


@dataclass(frozen=True)
class Size:
    """A painted sensor's; the pattern of the larger is coarse enough for the profiles
    that halve their images.
    """

    rows: int
    cols: int
    pitch_px: float
    disc: Disc

    def image(self, pressed_px: float = 0.0) -> U8:
        return marked(self.rows, self.cols, self.pitch_px, self.disc, pressed_px=pressed_px)

    def of(self, maker: Maker) -> U8:
        return np.ascontiguousarray(maker(self.rows, self.cols))

    def blended(self, part: float, maker: Maker, where: float) -> U8:
        """The reference with an extreme over it, wholly or in part, in a patch (radii):
        what a check may pass.
        """
        reference = self.image().astype(np.float64)
        row, col = np.ogrid[: self.rows, : self.cols]
        here = np.hypot(row - self.disc.row_c, col - self.disc.col_c) < where * self.disc.radius_px
        mixed = (1 - part) * reference + part * maker(self.rows, self.cols)
        return np.rint(np.where(here, mixed, reference)).astype(np.uint8)


def size_for(profile: str) -> Size:
    if PROFILES[profile].halved:
        return Size(191, 257, 16.0, Disc(94.6, 129.6, 84.0))
    return Size(96, 128, 8.0, Disc(47.3, 64.8, 42.0))


@cache
def calibration(size: Size, polarity: Polarity, binarisation: Binarisation) -> Calibration:
    return built_calibration(
        size.rows,
        size.cols,
        disc=size.disc,
        pitch_px=size.pitch_px,
        polarity=polarity,
        binarisation=binarisation,
        noise_grey=0.5,
    )


@cache
def made(
    profile: str, polarity: Polarity = "bright", binarisation: Binarisation = "adaptive"
) -> Reconstructor:
    return make_reconstructor(
        calibration(size_for(profile), polarity, binarisation), PROFILES[profile]
    )


BLENDS = ((0.5, 99), (1.0, 0.5), (0.6, 0.5))
"""Parts and radii."""


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("polarity", get_args(Polarity))
def test_every_extreme_frame_is_borne(profile: str, polarity: Polarity) -> None:
    """Each alone, and in one of the blends, in another on skins that darken."""
    turn = get_args(Polarity).index(polarity)
    seen = [
        sound_step(made(profile, polarity), size_for(profile).blended(part, image, where))
        for k, image in enumerate(EXTREME_IMAGES.values())
        for part, where in ((1.0, 99), BLENDS[(k + turn) % len(BLENDS)])
    ]
    # The images reach every way out: a solver's answer, no contact, an invalid frame.
    assert {(result.valid, result.contact) for result in seen} == {
        (True, True),
        (True, False),
        (False, False),
    }


@cache
def asked(profile: str) -> Reconstructor:
    return always_asked(calibration(size_for(profile), "bright", "adaptive"), profile)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@given(maker=makers(), part=st.floats(0.1, 1), where=st.floats(0.1, 1.5), over=st.none() | makers())
@examples(300)
def test_any_frame_is_borne(
    profile: str, maker: Maker, part: float, where: float, over: Maker | None
) -> None:
    size = size_for(profile)
    image = size.blended(part, maker, where)
    if over is not None:
        image = np.where(size.of(over) > 127, image, size.image())
    sound_step(asked(profile), image)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
def test_frames_before_a_frame_do_not_change_its_result(profile: str) -> None:
    size = size_for(profile)
    pressed = size.image(pressed_px=0.43 * size.disc.radius_px)
    whole = calibration(size, "bright", "adaptive")
    first = make_reconstructor(whole, PROFILES[profile]).step(Frame(0, 0, 0, pressed))
    later = make_reconstructor(whole, PROFILES[profile])
    for name, image in EXTREME_IMAGES.items():
        later.step(Frame(0, 0, 0, size.of(image)))
        assert everything(later.step(Frame(0, 0, 0, pressed))) == everything(first), name
    assert first.contact
