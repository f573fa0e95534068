from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from support.calibrated_sensor import TACTIP, calibrated, found_prints, pressed, simulated, step
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.types import U8, Calibration, Reconstruction

pytestmark = [
    pytest.mark.fit,
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("numba") is None, reason="numba (the extra fit) is not installed"),
]


def deeper(made: Reconstruction, factor: float) -> Reconstruction:
    height_mm = made.height.height_mm * np.float32(factor)
    return replace(made, height=replace(made.height, height_mm=height_mm))


def touches() -> list[U8]:
    """Different objects in different places."""
    rng = np.random.default_rng(5)
    names = sorted(OBJECTS)
    made = []
    for k in range(10):
        x, y = rng.uniform(-6, 6, 2)
        press = Press(OBJECTS[names[k % len(names)]](), x, y, rng.uniform(1.5, 4))
        made.append(simulated(TACTIP).frame((press,), 60 + k).image)
    return made


def own() -> Calibration:
    return calibrated(TACTIP, 0)


@pytest.mark.parametrize("thing", ["ball", "cube", "cylinder"])
def test_the_right_map_explains_a_picture_best(thing: str) -> None:
    from tacshade_edge.lab.fitting.explained import Changes, Twin

    frame = pressed(thing, 3.0)
    changes, twin = Changes(calibrated()), Twin(calibrated(), found_prints()[0])
    change = changes.of(frame.image)
    assert changes.is_touch(change)
    made = step("accurate", frame.image)
    left = {k: twin.unexplained(change, deeper(made, k)) for k in (0.5, 1.0, 1.6)}
    assert left[1.0] == min(left.values()) < 0.45
    assert np.square(twin.left(change, made)).sum() < np.square(change).sum()


def test_without_contact_nothing_is_explained() -> None:
    from tacshade_edge.lab.fitting.explained import Changes, Twin

    changes, twin = Changes(calibrated()), Twin(calibrated(), found_prints()[0])
    frame = pressed("ball", 3.0)
    nothing = replace(step("fast", frame.image), contact=False)
    assert twin.unexplained(changes.of(frame.image), nothing) == 1.0
    assert not changes.is_touch(changes.of(simulated().frame((), 9).image))


def test_touches_show_how_long_white_pins_are() -> None:
    from tacshade_edge.lab.fitting.explained import chosen_prints

    choice = chosen_prints(own(), [], touches())
    assert choice is not None
    assert choice.prints[0].kind.patches
    assert choice.left < 0.6
    length = choice.prints[0].values[0]
    assert 0.6 * TACTIP.pin_length_pitches < length < 1.7 * TACTIP.pin_length_pitches


def test_touches_rank_networks() -> None:
    from tacshade_edge.lab.fitting.explained import chosen_prints

    choice = chosen_prints(own(), [], touches())
    assert choice is not None
    made = choice.touches.reconstructed(own(), "accurate")
    left = choice.touches.left(made, choice.twin)
    assert left < choice.touches.left([deeper(each, 0.4) for each in made], choice.twin)
    assert left == pytest.approx(choice.left_by(own(), "accurate"))


def test_the_cloud_has_the_likely_prints_that_explain_touches_alike() -> None:
    from tacshade_edge.lab.fitting.explained import LIKELY, chosen_prints
    from tacshade_edge.lab.fitting.patches import with_length

    shown = found_prints()[0]
    twin_of_it = replace(shown, residual=1.01 * shown.residual)
    longer = with_length(shown, 2 * shown.values[0])
    unlikely = replace(shown, residual=1.1 * LIKELY * shown.residual)
    pictures = [
        simulated().frame((Press(OBJECTS["ball"](), 2.0 * k - 7, 0.0, 2.5),), 60 + k).image
        for k in range(8)
    ]
    choice = chosen_prints(calibrated(), [shown, longer, unlikely, twin_of_it], pictures)
    assert choice is not None
    assert [id(each) for each in choice.prints] == [id(shown), id(twin_of_it)]


def test_a_picture_that_its_map_does_not_explain_stands_out() -> None:
    from tacshade_edge.lab.fitting.explained import shares_left

    images = touches()[:5]
    still = simulated(TACTIP).frame((), 9).image
    found = shares_left(own(), [], "balanced", [*images, still])
    assert found[-1] is None
    seen = [left for left in found if left is not None]
    assert len(seen) == len(images)
    assert np.mean(seen) < 0.7
    assert shares_left(own(), [], "balanced", []) == []
