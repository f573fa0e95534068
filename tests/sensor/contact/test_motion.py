"""What a shift and turn of the whole pattern explain of a change, and what they leave."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.pin_pattern import N, X, Y, disc, pattern
from tacshade_edge.sensor.contact.motion import MOVED_ERROR, WhiteChange
from tacshade_edge.types import Bool


def change() -> WhiteChange:
    return WhiteChange(pattern(), disc())


@pytest.mark.parametrize(
    ("moved", "radii"),
    [({"shift_x": 0.02}, 0.02), ({"shift_y": -0.02}, 0.02), ({"turn": 0.025}, 0.025)],
)
def test_a_motion_of_the_whole_pattern_explains_the_change(
    moved: dict[str, float], radii: float
) -> None:
    found = change().motion(pattern(**moved))
    assert found.explained > 0.9
    assert found.moved_radii == pytest.approx(radii, rel=0.15)
    assert change().local(pattern(**moved)) < 0.01


def test_light_is_no_change() -> None:
    lit = pattern(gain=0.9) + np.float32(0.02) * X.astype(np.float32)
    assert change().local(lit) == pytest.approx(0, abs=1e-4)
    assert change().motion(lit).moved_radii < 1e-3


def test_a_touch_is_a_local_change_that_no_motion_explains() -> None:
    bump = (0.2 * np.exp(-((X - 0.3) ** 2 + Y**2) / (2 * 0.1**2))).astype(np.float32)
    alone = change().local(pattern() + bump)
    assert change().motion(pattern() + bump).explained < 0.1
    assert alone > 0.05
    assert change().local(pattern(turn=0.02) + bump) == pytest.approx(alone, rel=0.3)


def test_noise_that_is_the_same_everywhere_is_no_local_change() -> None:
    noise = np.random.default_rng(5).normal(0, 0.02, (N, N)).astype(np.float32)
    assert change().motion(pattern() + noise).explained < 0.05
    assert abs(change().local(pattern() + noise)) < 0.005


def test_a_pattern_without_gradient_shows_no_motion() -> None:
    flat = np.full((N, N), 0.4, np.float32)
    for white in (pattern(), flat):
        still = WhiteChange(flat, disc()).motion(white)
        assert (still.explained, still.moved_radii) == (0, 0)
    assert abs(WhiteChange(flat, disc()).local(flat)) < 1e-6
    nowhere = WhiteChange(flat, np.zeros((N, N), bool))
    assert (nowhere.motion(pattern()).explained, nowhere.local(pattern())) == (0, 0)


@examples(25)
@given(
    st.sampled_from(["pattern", "turned", "noise", "black", "white"]),
    st.sampled_from(["disc", "beyond the end", "nothing"]),
    st.integers(0, 2**32 - 1),
)
def test_how_far_it_goes_is_known_within_its_bound(kind: str, where: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    inside: Bool = {
        "disc": disc(),
        # The smoothing of what is inside reaches where the picture ends.
        "beyond the end": np.hypot(X - rng.uniform(-0.8, 0.8), Y + 0.5) < 1.2,
        "nothing": np.zeros((N, N), bool),
    }[where]
    white = {
        "pattern": pattern(*rng.uniform(-0.05, 0.05, 3), rng.uniform(0.5, 1.5)),
        "turned": pattern(turn=0.3),
        "noise": rng.random((N, N), np.float32),
        "black": np.zeros((N, N), np.float32),
        "white": np.ones((N, N), np.float32),
    }[kind]
    one = WhiteChange(pattern(), inside)
    found = one.motion(white).moved_radii
    assert abs(one.moved_radii(white) - found) <= MOVED_ERROR
