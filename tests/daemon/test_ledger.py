"""The ledger of what becomes of each frame, and how long its stages take."""

from __future__ import annotations

import threading
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.pipeline.ledger import START_S, WINDOW_FRAMES, FrameLedger, FrameOutcome, Timings

OUTCOMES: tuple[FrameOutcome, ...] = get_args(FrameOutcome)


@given(st.lists(st.sampled_from([*OUTCOMES, None, "undecodable"]), max_size=40))
def test_captured_is_the_sum_of_the_outcomes_and_of_what_is_pending(
    ends: list[FrameOutcome | str | None],
) -> None:
    ledger = FrameLedger()
    for seq, end in enumerate(ends):
        if end in ("undecodable", "unasked"):
            ledger.passed("unasked" if end == "unasked" else "failed")
            continue
        ledger.captured(seq)
        for outcome in OUTCOMES:
            if end == outcome:
                ledger.settle(seq, outcome)
    counts = ledger.counts().as_dict()
    expected = {outcome: ends.count(outcome) for outcome in OUTCOMES}
    expected["failed"] += ends.count("undecodable")
    assert counts == {"captured": len(ends), **expected, "pending": ends.count(None)}
    assert ledger.close(0) == ends.count(None)
    after = ledger.counts()
    assert (after.pending, after.failed) == (0, expected["failed"] + ends.count(None))
    ledger.captured(100)
    ledger.settle(0, "published")
    ledger.passed("failed")
    assert ledger.counts() == after


def test_close_waits_for_frames_that_are_still_on_their_way() -> None:
    ledger = FrameLedger()
    ledger.captured(0)
    late = threading.Timer(0.05, ledger.settle, (0, "published"))
    late.start()
    assert ledger.close(10) == 0
    assert ledger.counts().published == 1
    late.join()


def test_booking_a_frame_twice_is_a_defect() -> None:
    ledger = FrameLedger()
    ledger.captured(3)
    with pytest.raises(KeyError):
        ledger.captured(3)
    ledger.settle(3, "published")
    with pytest.raises(KeyError):
        ledger.settle(3, "failed")
    assert ledger.counts().as_dict()["captured"] == 1


def test_percentiles_are_nearest_rank_over_the_latest_frames() -> None:
    timings = Timings()
    assert timings.percentiles() == {}
    timings.add({"a": 5.0})
    assert timings.percentiles() == {"a": {"p50": 5.0, "p99": 5.0}}
    for i in range(1, 101):
        timings.add({"b": float(i)})
    assert timings.percentiles()["b"] == {"p50": 50.0, "p99": 99.0}
    for _ in range(WINDOW_FRAMES):
        timings.add({"b": 7.0})
    assert timings.percentiles()["b"] == {"p50": 7.0, "p99": 7.0}


def test_the_start_is_forgotten_once_it_is_over() -> None:
    now_s = 100.0
    timings = Timings(lambda: now_s)
    for name in ("a", "b"):
        timings.add({name: 900.0})
    now_s += START_S
    timings.add({"a": 800.0})
    assert timings.percentiles()["a"] == {"p50": 800.0, "p99": 900.0}
    now_s += 0.1
    timings.add({"a": 5.0})
    timings.add({"a": 6.0})
    assert timings.percentiles() == {
        "a": {"p50": 5.0, "p99": 6.0},
        "b": {"p50": 900.0, "p99": 900.0},
    }, "b has no other value yet"
