"""Clocks of robots, honest and in other units, on lines that delay."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.stream_clock import StreamClock
from tacshade_edge.plausibility.suspicions import SuspicionCode
from tacshade_edge.plausibility.units import TIMES, UnitName

S = 10**9


def stream(seed: int, hz: float, seconds: float, drift: float) -> list[tuple[float, float]]:
    """Sent and arrived in s, of a line that delays, and now and then holds all back for a while."""
    draw = random.Random(seed)
    sent, arrived, free_s = [], [], 0.0
    for k in range(int(seconds * hz)):
        at_s = k / hz
        if draw.random() < 0.01:
            free_s = max(free_s, at_s + draw.uniform(0, 4))
        free_s = max(free_s, at_s + draw.expovariate(200))
        sent.append(at_s * (1 + drift))
        arrived.append(free_s)
    return list(zip(sent, arrived, strict=True))


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([0.3, 1, 2, 10, 30, 100, 500]),
    st.floats(-0.05, 0.05),
    st.integers(0, 2**60),
)
def test_no_honest_clock_is_suspected(seed: int, hz: float, drift: float, start_ns: int) -> None:
    clock = StreamClock()
    for k, (sent_s, arrived_s) in enumerate(stream(seed, hz, min(3000 / hz, 60), drift)):
        # Clocks are set, to an hour later.
        jumped = 3_600 * S if k >= 20 * hz else 0
        clock.take(start_ns + round(sent_s * S) + jumped, round(arrived_s * S))
        assert clock.found is None


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([2, 10, 30, 100, 500]),
    st.sampled_from(list(TIMES)),
    st.booleans(),
)
def test_every_other_unit_is_suspected_by_name(
    seed: int, hz: float, unit: UnitName, is_backwards: bool
) -> None:
    clock, draw = StreamClock(), random.Random(seed)
    sign = -1 if is_backwards else 1
    for k in range(int(8 * hz)):
        at_s = k / hz
        stamp = 10**12 + sign * int(at_s * S / TIMES[unit])
        clock.take(stamp, round((at_s + draw.uniform(0, 0.01)) * S))
    assert clock.found is not None
    if is_backwards:
        assert clock.found.code is SuspicionCode.CLOCK_COUNTS_DOWN
    else:
        assert clock.found.code is SuspicionCode.CLOCK_RATE
        assert f"in {unit}?" in str(clock.found)
    # The robot's program is corrected while it runs.
    for k in range(int(4 * hz)):
        clock.take(10**15 + round(k * S / hz), round((100 + k / hz) * S))
    assert clock.found is None


def test_a_time_that_stands_is_no_other_unit() -> None:
    clock = StreamClock()
    for k in range(100):
        clock.take(5 * S, k * S // 10)
    assert clock.found is None
    assert "stand still" in str(clock.stands)
    for k in range(100, 200):
        clock.take(5 * S + k * S // 10, k * S // 10)
        assert clock.found is None
    assert clock.stands is None
