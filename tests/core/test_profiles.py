from __future__ import annotations

import pytest

from tacshade_edge.core.depth import SOLVERS
from tacshade_edge.core.profiles import PROFILES


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_can_be_run(name: str) -> None:
    profile = PROFILES[name]
    assert profile.name == name
    assert profile.solver in SOLVERS
    assert profile.stride_px >= 1
    assert profile.window_pitches >= 1  # a whole number: the pattern itself averages out
    assert isinstance(profile.window_pitches, int)
    assert profile.tv_weight >= 0


def test_those_of_the_spine_are_there() -> None:
    assert set(PROFILES) == {"paper", "fast", "balanced", "accurate"}
    assert PROFILES["paper"].stride_px == 1


def test_every_profile_shares_the_window_that_the_gate_was_made_with() -> None:
    assert len({profile.window_pitches for profile in PROFILES.values()}) == 1
