"""Places of robots, honest and in other units, while their sensors press."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.stream_places import PRESSES, SAMPLES_LEAST, StreamPlaces
from tacshade_edge.plausibility.suspicions import SuspicionCode
from tacshade_edge.plausibility.units import LENGTHS, UnitName

Sample = tuple[tuple[float, float, float], int, float | None]
STILL = (1.0, 0.0, 0.0, 0.0)


def robot(seed: int, size_mm: float, hz: float, travel_mm: float, presses: int) -> Iterator[Sample]:
    """A robot that presses here and there: its places in mm, their times and the depths found."""
    draw = random.Random(seed)
    step_ns, t_ns = round(1e9 / hz), draw.randrange(10**15)
    jitter_mm, digits = draw.choice([0.0, 0.0005, 0.02]), draw.choice([2, 4, 6])
    seen = draw.uniform(0.6, 1.4)  # depths of a poor calibration
    x = y = 0.0
    up_mm = draw.uniform(0.2, 1.0) * size_mm

    def at(z_mm: float) -> tuple[float, float, float]:
        noisy = (round(v + draw.gauss(0, jitter_mm), digits) for v in (x + 300, y - 40, z_mm))
        return tuple(noisy)  # type: ignore[return-value]

    for _ in range(presses):
        deep_mm = draw.uniform(0.04, 0.2) * size_mm
        down = max(10, round(hz * draw.uniform(0.5, 3)))
        ways = [up_mm - (up_mm + deep_mm) * k / down for k in range(down + 1)]
        for z_mm in [*ways, *[-deep_mm] * draw.randrange(5), *reversed(ways)]:
            t_ns += step_ns
            depth_mm = max(0.0, -z_mm) * seen
            yield at(z_mm), t_ns, depth_mm + abs(draw.gauss(0, 0.02)) if z_mm < 0 else None
        x0, y0 = x, y
        x1, y1 = draw.uniform(0, travel_mm), draw.uniform(0, travel_mm)
        for k in range(5):
            t_ns += max(step_ns, round(1e9 * travel_mm / 2000))
            x, y = x0 + (x1 - x0) * k / 4, y0 + (y1 - y0) * k / 4
            yield at(up_mm), t_ns, None


SIZES = st.floats(5, 60)
RATES = st.sampled_from([5, 15, 30, 60])


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), SIZES, RATES, st.sampled_from([0.0, 2.0, 60.0, 800.0]))
def test_no_honest_robot_is_suspected(
    seed: int, size_mm: float, hz: float, travel_mm: float
) -> None:
    places = StreamPlaces(size_mm)
    for place, t_ns, depth_mm in robot(seed, size_mm, hz, travel_mm, 6):
        places.take(place, t_ns, depth_mm, STILL)
        assert places.found is None


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(
    st.integers(0, 10**6),
    SIZES,
    RATES,
    st.sampled_from([2.0, 60.0, 800.0]),
    st.sampled_from([UnitName.CM, UnitName.INCH]),
)
def test_places_in_centimetres_or_inches_are_suspected_and_forgiven(
    seed: int, size_mm: float, hz: float, travel_mm: float, unit: UnitName
) -> None:
    places, of = StreamPlaces(size_mm), LENGTHS[unit]
    stream = list(robot(seed, size_mm, hz, travel_mm, 6))
    said = set()
    for (x, y, z), t_ns, depth_mm in stream:
        places.take((round(x / of, 5), round(y / of, 5), round(z / of, 5)), t_ns, depth_mm, STILL)
        said.add(places.found and (places.found.code, places.found.impossible))
    assert said <= {None, (SuspicionCode.PLACES_SHORT, False)}
    for place, t_ns, depth_mm in robot(seed, size_mm, hz, travel_mm, 6):
        places.take(place, t_ns + 10**17, depth_mm, STILL)
    assert places.found is None or longest(stream) < SAMPLES_LEAST


def longest(stream: list[Sample]) -> int:
    """The frames of the longest press."""
    touched = "".join(".#"[depth_mm is not None] for _, _, depth_mm in stream)
    return max(map(len, touched.split(".")))


@pytest.mark.slow
@pytest.mark.parametrize("unit", [UnitName.CM, UnitName.INCH])
def test_nearly_all_places_in_centimetres_or_inches_are_named(unit: UnitName) -> None:
    named, other, of = 0, 0, LENGTHS[unit]
    for seed in range(60):
        draw = random.Random(seed)
        size_mm, hz = draw.uniform(5, 60), draw.choice([15, 30, 60])
        places = StreamPlaces(size_mm)
        for (x, y, z), t_ns, depth_mm in robot(seed, size_mm, hz, draw.choice([2, 60, 800]), 6):
            place = (round(x / of, 5), round(y / of, 5), round(z / of, 5))
            places.take(place, t_ns, depth_mm, STILL)
        named += f"are they in {unit}?" in str(places.found)
        other += places.found is not None and f"are they in {unit}?" not in str(places.found)
    # A calibration may be off so much that one unit looks like the other.
    assert named >= 51, named
    assert other <= 6, other


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), SIZES, RATES)
def test_a_robot_that_turns_its_wrist_is_not_suspected(
    seed: int, size_mm: float, hz: float
) -> None:
    """Its flange moves a tenth as far as the sensor at the end of the finger."""
    places = StreamPlaces(size_mm)
    for (x, y, z), t_ns, depth_mm in robot(seed, size_mm, hz, 60.0, 6):
        turned = z / 100
        facing = (math.cos(turned / 2), math.sin(turned / 2), 0.0, 0.0)
        places.take((x, y, z / 10), t_ns, depth_mm, facing)
        assert places.found is None
    # Nor one of which nobody knows how it stands.
    for (x, y, z), t_ns, depth_mm in robot(seed, size_mm, hz, 60.0, 6):
        places.take((x, y, z / 10), t_ns, depth_mm)
        assert places.found is None


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), SIZES, RATES, st.floats(0.0, 0.3), st.floats(5, 5000))
def test_no_robot_that_is_pressed_or_grips_is_suspected(
    seed: int, size_mm: float, hz: float, jitter_mm: float, stiff: float
) -> None:
    """A person presses on a standing robot, which gives way; a gripper closes while its arm
    settles, after it has moved far.
    """
    draw = random.Random(seed)
    places, t_ns = StreamPlaces(size_mm), 0
    goes_far = draw.random() < 0.5
    for _ in range(6):
        home = draw.uniform(-500, 500) if goes_far else 0.0
        deep_mm = draw.uniform(0.03, 0.2) * size_mm
        for k in range(40):
            t_ns += round(1e9 / hz)
            depth_mm = deep_mm * max(0.0, 1 - abs(k - 20) / 15)
            at = home + depth_mm / stiff
            place = (at + draw.gauss(0, jitter_mm), draw.gauss(0, jitter_mm), 300.0)
            places.take(place, t_ns, depth_mm or None, STILL)
            assert places.found is None


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), SIZES, RATES, st.sampled_from([60.0, 800.0]))
def test_places_in_metres_are_suspected_and_forgiven(
    seed: int, size_mm: float, hz: float, travel_mm: float
) -> None:
    places = StreamPlaces(size_mm)
    stream = list(robot(seed, size_mm, hz, travel_mm, 6))
    for (x, y, z), t_ns, depth_mm in stream:
        place = (round(x / 1000, 6), round(y / 1000, 6), round(z / 1000, 6))
        places.take(place, t_ns, depth_mm, STILL)
    touched = "".join(".#"[depth_mm is not None] for _, _, depth_mm in stream)
    long = [press for press in touched.split(".") if len(press) >= SAMPLES_LEAST]
    assert places.found is not None or len(long) < PRESSES
    if places.found is not None:
        assert places.found.code is SuspicionCode.PLACES_SMALL
        assert "are they in m?" in str(places.found)
    for place, t_ns, depth_mm in robot(seed, size_mm, hz, travel_mm, 2):
        places.take(place, t_ns + 10**17, depth_mm, STILL)
    assert places.found is None


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), SIZES, RATES)
def test_places_in_micrometres_move_too_fast(seed: int, size_mm: float, hz: float) -> None:
    draw = random.Random(seed)
    places, fast = StreamPlaces(size_mm), draw.uniform(30, 1000)
    for k in range(round(4 * hz)):
        t_ns = round(k * 1e9 / hz)
        places.take((fast * 1000 * t_ns / 1e9, 0.0, 0.0), t_ns, None)
    assert places.found is not None
    assert "are they in µm?" in str(places.found)
    for k in range(round(5 * hz)):
        t_ns = 10**10 + round(k * 1e9 / hz)
        places.take((fast * t_ns / 1e9, 0.0, 0.0), t_ns, None)
    assert places.found is None or fast < 200
