from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import pytest

from tacshade_edge.core.profiles import AUTO, LADDER, PROFILES
from tacshade_edge.daemon.profiles import CALM_S, PATIENCE_S, WINDOW_FRAMES, ActiveProfile, Stepped, step_cost_ms
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.types import Calibration, Frame

pytestmark = pytest.mark.slow

BUDGET_MS = 10_000.0  # for the slowest machine: what is late is told, not measured
BEST, CHEAPEST = LADDER[0], LADDER[-1]


class Daemon:
    """An active profile whose measurements the test tells."""

    def __init__(self, calibration: Calibration, choice: str = AUTO, budget_ms: float | None = BUDGET_MS) -> None:
        made = make_reconstructor(calibration, PROFILES[CHEAPEST])
        self.stepped: list[Stepped] = []
        self.active = ActiveProfile(made, choice, budget_ms, self.stepped.append)
        self.now_ns = 0

    def frames(self, count: int, latency_ms: float, apart_s: float = 0.1) -> None:
        for _ in range(count):
            self.now_ns += round(1e9 * apart_s)
            self.active.observe(self.profile, self.now_ns, latency_ms, 1.0)

    @property
    def profile(self) -> str:
        return self.active.reconstructor.profile.name

    def fall(self) -> None:
        """To the cheapest."""
        for _ in LADDER[1:]:
            self.frames(7, 2 * BUDGET_MS)
            assert self.active.step(self.stepped[-1])
        assert self.profile == CHEAPEST


def test_the_ladder_goes_from_the_most_accurate_to_the_fastest() -> None:
    assert (BEST, CHEAPEST) == ("accurate", "fast")
    assert set(LADDER) < set(PROFILES)


def test_a_step_is_wanted_in_the_one_thread_and_done_in_the_other(
    calibration: Calibration, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    daemon = Daemon(calibration)
    assert (daemon.profile, daemon.active.choice) == (BEST, AUTO)
    assert f"profile auto: starting with {BEST} for a budget of 10000 ms; measured costs: {BEST} " in caplog.text
    assert daemon.active.health() == {
        "latency_budget_ms": BUDGET_MS,
        "profile": BEST,
        "kept": None,
        "p90_ms": None,
        "steps_down": 0,
        "steps_up": 0,
    }
    daemon.frames(7, 2 * BUDGET_MS)
    assert daemon.profile == BEST
    (stepped,) = daemon.stepped
    assert daemon.active.step(stepped)
    assert daemon.profile == LADDER[1]
    assert caplog.records[-1].getMessage() == (
        f"profile auto: stepped from {BEST} down to {LADDER[1]}: "
        "7 of the latest 7 frames in contact took more than 10000 ms"
    )
    assert caplog.records[-1].levelno == logging.INFO
    daemon.frames(WINDOW_FRAMES, 1.0)
    budget = daemon.active.health()
    assert budget is not None
    assert (budget["kept"], budget["p90_ms"], budget["steps_down"]) == (True, 1.0, 1)


def test_a_step_makes_nothing_and_a_profile_comes_back_as_it_was(calibration: Calibration) -> None:
    daemon = Daemon(calibration)
    best = daemon.active.reconstructor
    daemon.fall()
    while daemon.profile != BEST:
        daemon.frames(WINDOW_FRAMES, 1.0, apart_s=PATIENCE_S / (WINDOW_FRAMES - 2))
        assert daemon.active.step(daemon.stepped[-1])
    assert daemon.active.reconstructor is best
    budget = daemon.active.health()
    assert budget is not None
    assert budget["steps_down"] == budget["steps_up"] == len(LADDER) - 1


def test_another_reference_or_calibration_keeps_the_profile_and_what_was_found_out(calibration: Calibration) -> None:
    daemon = Daemon(calibration)
    daemon.frames(7, 2 * BUDGET_MS)
    other = with_crc(replace(calibration, noise_grey=calibration.noise_grey + 1))
    daemon.active.use(other)  # between the wish and the step
    assert (daemon.profile, daemon.active.reconstructor.calibration.crc32) == (BEST, other.crc32)
    assert daemon.active.step(daemon.stepped[0])
    assert (daemon.profile, daemon.active.reconstructor.calibration.crc32) == (LADDER[1], other.crc32)
    daemon.active.reload(AUTO, BUDGET_MS, calibration)
    assert (daemon.profile, daemon.active.reconstructor.calibration.crc32) == (LADDER[1], calibration.crc32)
    daemon.active.reload(AUTO, 2 * BUDGET_MS, calibration)  # another budget: from the start
    assert (daemon.profile, daemon.active.budget_ms) == (BEST, 2 * BUDGET_MS)


def test_a_profile_that_was_asked_for_ends_auto_and_a_late_wish_is_not_heard(calibration: Calibration) -> None:
    daemon = Daemon(calibration)
    assert daemon.active.choices == (*PROFILES, AUTO)
    daemon.frames(7, 2 * BUDGET_MS)
    daemon.active.choose(CHEAPEST)
    assert (daemon.profile, daemon.active.choice) == (CHEAPEST, CHEAPEST)
    assert daemon.active.health() is None
    daemon.frames(20, 2 * BUDGET_MS)
    assert len(daemon.stepped) == 1
    assert not daemon.active.step(daemon.stepped[0])
    daemon.active.choose(AUTO)
    assert not daemon.active.step(daemon.stepped[0])  # that of the chooser before
    assert (daemon.profile, daemon.active.choice) == (BEST, AUTO)


def test_a_fixed_profile_watches_nothing(calibration: Calibration) -> None:
    daemon = Daemon(calibration, CHEAPEST, None)
    made = daemon.active.reconstructor
    assert daemon.active.choices == tuple(PROFILES)
    daemon.frames(20, 2 * BUDGET_MS)
    assert (daemon.active.health(), daemon.stepped) == (None, [])
    daemon.active.reload(CHEAPEST, None, calibration)
    assert daemon.active.reconstructor is not made
    daemon.active.reload("paper", None, calibration)
    assert daemon.profile == "paper"


def test_a_budget_that_the_fastest_does_not_keep_is_told_once(
    calibration: Calibration, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = Daemon(calibration)
    daemon.fall()

    def warnings() -> list[str]:
        daemon.active.log_late()
        return [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]

    assert warnings() == []
    daemon.frames(20, 2 * BUDGET_MS)
    assert (
        warnings()
        == warnings()
        == [f"{CHEAPEST}, the fastest profile, misses the budget of 10000 ms: 90 % of frames took up to 20000.0 ms"]
    )
    daemon.frames(WINDOW_FRAMES, 0.9 * BUDGET_MS)
    for _ in range(CALM_S - 1):
        assert len(warnings()) == 1
    daemon.frames(20, 2 * BUDGET_MS)
    assert len(warnings()) == 1
    daemon.frames(WINDOW_FRAMES, 0.9 * BUDGET_MS)
    for _ in range(CALM_S):
        assert len(warnings()) == 1
    daemon.frames(20, 2 * BUDGET_MS)
    assert len(warnings()) == 2


@pytest.mark.parametrize("name", LADDER)
def test_what_a_step_costs_is_measured(calibration: Calibration, pictures: Any, name: str) -> None:
    made = make_reconstructor(calibration, PROFILES[name])
    before = made.step(Frame(0, 0, 0, pictures.touched))
    assert 0 < step_cost_ms(made) < BUDGET_MS
    after = made.step(Frame(0, 0, 0, pictures.touched))
    assert after.depth_max_mm == before.depth_max_mm  # and leaves nothing behind
