from dataclasses import replace

from support.trade_points import point

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.tradeoff.budget import best_within, over_budget, settings_block

POINTS = [point("fast", 0.2, 1.0), point("accurate", 0.15, 3.0), point("paper", 2.0, 500.0)]


def chosen(budget_ms: float) -> str | None:
    block = settings_block(POINTS, budget_ms)
    return block and block.splitlines()[-1]


def test_the_most_accurate_that_keeps_the_budget_in_99_of_100_frames() -> None:
    assert chosen(1.9) is None
    assert chosen(2.0) == "profile: fast"
    assert chosen(5.9) == "profile: fast"
    assert chosen(6.0) == "profile: accurate"
    assert chosen(5000) == "profile: accurate"
    best = best_within(POINTS, 5000)
    assert best is not None
    assert best.setting.profile.name == "accurate"


def test_a_better_one_that_cannot_be_set_is_told_when_it_is_clearly_better() -> None:
    clearly = point(replace(PROFILES["accurate"], stride_px=8), 0.1, 0.9)
    block = settings_block([*POINTS, clearly], 2.0)
    assert block is not None
    told, better, setting = block.splitlines()
    assert told.startswith("# The most accurate within 2 ms")
    assert "p99 2.00 ms, p50 1.00 ms, ME 0.200 mm" in told
    assert better.startswith("# Better, but not a shipped profile: accurate, stride 8 px")
    assert setting == "profile: fast"
    hardly = point(replace(PROFILES["accurate"], stride_px=8), 0.19, 0.9)
    assert len((settings_block([*POINTS, hardly], 2.0) or "").splitlines()) == 2


def test_a_budget_that_none_keeps_is_told_with_the_nearest() -> None:
    assert "the fastest, fast, takes 2.00 ms (p99)" in over_budget(POINTS, 1.0)
    assert "none can be chosen" in over_budget([], 1.0)
