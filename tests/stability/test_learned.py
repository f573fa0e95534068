"""The shipped networks on whites that no frame has:
finite, bounded, the same twice, and whoever runs them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.examples import examples
from support.extremes import EXTREME_IMAGES
from support.networks import float_network
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.depth.learned import Inverse, LearnedInverse, known_maps
from tacshade_edge.sensor.inference.network import WEIGHTS, load_network
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, Disc, Geometry

NAMES = [name for name, profile in PROFILES.items() if profile.network]
# Heights in skin radii and log odds, on anything; the gate and the limit at r come after.
MOST_RADII, MOST_LOGIT = 2.0, 300.0


@cache
def network(name: str) -> Network:
    return load_network(name)


def white(profile: str, image: str) -> F32:
    cells = PROFILES[profile].cells
    return EXTREME_IMAGES[image](cells, cells).astype(np.float32) / np.float32(255)


def sound_answer(inverse: LearnedInverse, cells: F32, radius_mm: float) -> Inverse:
    answer = inverse(cells)
    for values in (answer.height_mm, answer.contact_logit):
        assert values.shape == cells.shape
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
    assert float(np.abs(answer.height_mm).max()) <= MOST_RADII * radius_mm
    assert float(np.abs(answer.contact_logit).max()) <= MOST_LOGIT
    again = inverse(cells)
    assert again.height_mm.tobytes() == answer.height_mm.tobytes()
    assert again.contact_logit.tobytes() == answer.contact_logit.tobytes()
    return answer


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_extreme_white_gives_an_answer(name: str) -> None:
    geometry = Geometry(20.0, 14.0, 50.0, Disc(239.5, 319.5, 200.0))
    tops, logits = [], []
    for reference in ("constant 0", "constant 255", "checkerboard 8 px"):
        inverse = LearnedInverse(network(name), geometry, 20.0, white(name, reference))
        for image in EXTREME_IMAGES:
            answer = sound_answer(inverse, white(name, image), 20.0)
            tops.append(float(answer.height_mm.max()))
            logits.append(float(np.abs(answer.contact_logit).max()))
    print(
        f"figure: {name} on whites that no frame has: "
        f"heights up to {max(tops):.1f} mm on a skin of 20 mm"
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@given(
    radius_mm=st.floats(1, 200),
    distance_mm=st.none() | st.floats(0, 1000, exclude_min=True),
    half_angle_deg=st.floats(5, 85),
    pitch=st.floats(0.01, 2),
    base=st.sampled_from(sorted(EXTREME_IMAGES)),
    patch=arrays(np.float32, (8, 8), elements=st.floats(0, 1, width=32)),
    where=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
@examples(100)
def test_any_sensor_and_white_gives_an_answer(
    name: str,
    radius_mm: float,
    distance_mm: float | None,
    half_angle_deg: float,
    pitch: float,
    base: str,
    patch: F32,
    where: tuple[float, float],
) -> None:
    disc = Disc(47.0, 64.0, 40.0)
    geometry = Geometry(radius_mm, distance_mm, half_angle_deg, disc)
    cells = white(name, base)
    row, col = (int(part * (len(cells) - 8)) for part in where)
    cells[row : row + 8, col : col + 8] = patch
    inverse = LearnedInverse(
        network(name), geometry, pitch * disc.radius_px, white(name, "checkerboard 8 px")
    )
    sound_answer(inverse, cells, radius_mm)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_another_engine_gives_the_same(name: str, tmp_path: Path) -> None:
    """OpenCV adds float32 in another order: how far the two differ is what rounding does."""
    parts = [
        cv2.dnn.readNetFromONNX(np.fromfile(WEIGHTS / f"{name}{part}.onnx", np.uint8))
        for part in (".sensor", "")
    ]

    def sense(known: F32) -> F32:
        parts[0].setInput(np.ascontiguousarray(known[None]), "known")
        return np.array(parts[0].forward()[0], np.float32)

    def run(white: F32, sensor: F32, _: object) -> list[F32]:
        parts[1].setInput(np.ascontiguousarray(white[None]), "white")
        parts[1].setInput(np.ascontiguousarray(sensor[None]), "sensor")
        return [output[0] for output in parts[1].forward(("depth_and_contact", "foreign"))]

    geometry = Geometry(20.0, 14.0, 50.0, Disc(239.5, 319.5, 200.0))
    reference = white(name, "checkerboard 8 px")
    exact = float_network(name, tmp_path)
    known = known_maps(geometry, 20.0, reference, exact.fold)
    np.testing.assert_allclose(sense(known), exact.sense(known), rtol=0, atol=2**-10)
    ours, theirs = (
        LearnedInverse(net, geometry, 20.0, reference) for net in (exact, replace(exact, run=run))
    )
    worst = 0.0
    for image in EXTREME_IMAGES:
        one, two = ours(white(name, image)), theirs(white(name, image))
        scale = max(float(np.abs(one.height_mm).max()), 1.0)
        worst = max(worst, float(np.abs(one.height_mm - two.height_mm).max()) / scale)
        np.testing.assert_allclose(one.contact_logit, two.contact_logit, atol=1e-2)
    print(f"figure: {name}, two engines: heights {worst:.0e} of the greatest apart at most")
    assert worst < 1e-4
