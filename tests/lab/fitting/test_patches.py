from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from support.calibrated_sensor import TACTIP, calibrated, simulated
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.skin import undeformed
from tacshade_edge.lab.simulator.truth import skin_under

pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(find_spec("numba") is None, reason="numba (the extra fit) is not installed"),
]


def test_patches_at_rest_are_the_reference() -> None:
    from tacshade_edge.lab.fitting.patches import own_picture, renderer_of

    calibration = calibrated(TACTIP, 0)
    found = own_picture(calibration)
    assert found is not None
    drawn = renderer_of(found, *found.at(found.values)).draw(undeformed(TACTIP.skin_radius_mm))
    off = np.abs(drawn - calibration.reference_grey)
    # Tips may lie up to half a thousandth of a pixel beside their patches.
    assert np.percentile(off, 99.9) < 1.0


def test_patches_move_as_the_skin_moves_the_tips() -> None:
    from tacshade_edge.lab.fitting.patches import own_picture, renderer_of, with_length
    from tacshade_edge.lab.fitting.prints import WhiteMap

    calibration = calibrated(TACTIP, 0)
    own = own_picture(calibration)
    assert own is not None
    found = with_length(own, TACTIP.pin_length_pitches)
    renderer = renderer_of(found, *found.at(found.values))
    renderer.model = replace(renderer.model, friction=TACTIP.friction)
    press = Press(ball(6.0), 2.0, -3.0, 3.0)
    pictured = simulated(TACTIP).frame((press,), 3).image[..., 0]
    drawn = renderer.draw(skin_under(TACTIP, (press,)))
    white = WhiteMap(calibration)
    seen = white.of(pictured) - white.reference()
    left = seen - (white.of(drawn.clip(0, 255).astype(np.uint8)) - white.reference())
    assert np.square(left).sum() < 0.35 * np.square(seen).sum()


def test_too_few_tips_make_no_twin() -> None:
    from tacshade_edge.lab.fitting.patches import own_picture

    plain = calibrated(TACTIP, 0)
    flat = np.full_like(plain.reference_grey, 40)
    assert own_picture(replace(plain, reference_grey=flat)) is None
