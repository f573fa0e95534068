"""Places of a hand's fingers, honest and in other units."""

from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.hand_places import judge_fingers
from tacshade_edge.plausibility.units import LENGTHS, UnitName

Places = dict[str, tuple[float, float, float]]


@st.composite
def hands(draw: st.DrawFn) -> tuple[Places, dict[str, float]]:
    """Fingers of 2.5 to 60 mm radius around a grasp, none of which overlap."""
    count, size_mm = draw(st.integers(2, 16)), draw(st.floats(2.5, 60))
    around_mm = size_mm / math.sin(math.pi / count) * draw(st.floats(0.85, 4))
    x, y, z = (draw(st.floats(-300, 300)) for _ in range(3))
    places = {
        f"f{k}": (
            x + around_mm * math.cos(2 * math.pi * k / count),
            y + around_mm * math.sin(2 * math.pi * k / count),
            z,
        )
        for k in range(count)
    }
    return places, dict.fromkeys(places, size_mm) if draw(st.booleans()) else {}


def in_unit(places: Places, mm: float) -> Places:
    return {name: (x / mm, y / mm, z / mm) for name, (x, y, z) in places.items()}


@settings(max_examples=200)
@given(hands())
def test_no_honest_hand_is_suspected(hand: tuple[Places, dict[str, float]]) -> None:
    places, sizes = hand
    if max(math.dist(places["f0"], at) for at in places.values()) < 1500:
        assert judge_fingers(places, sizes) is None


@settings(max_examples=200)
@given(hands())
def test_hands_in_metres_are_named(hand: tuple[Places, dict[str, float]]) -> None:
    places, sizes = hand
    nearest = math.dist(places["f0"], places["f1"])
    if nearest < 1000:
        name, found = judge_fingers(in_unit(places, LENGTHS[UnitName.M]), sizes) or ("", None)
        assert found is not None
        assert found.impossible
        assert name in places
        assert "are they in m?" in str(found)


@settings(max_examples=200)
@given(hands(), st.sampled_from([UnitName.CM, UnitName.INCH]))
def test_hands_in_centimetres_or_inches_are_doubted_where_fingers_are_near(
    hand: tuple[Places, dict[str, float]], unit: UnitName
) -> None:
    places, _ = hand
    apart = sorted(math.dist(places["f0"], at) for name, at in places.items() if name != "f0")
    # Of one finger alone, as each daemon knows; it looks at half of its own radius.
    for size_mm in (apart[0] / 2, apart[0]):
        name, found = judge_fingers(in_unit(places, LENGTHS[unit]), {"f0": size_mm}) or ("", None)
        assert found is not None
        assert name in places
        assert "in cm?" in str(found) or "in inches?" in str(found) or found.impossible
        assert judge_fingers({**places, "f0": places["f0"]}, {"f0": size_mm}) is None


def test_centimetres_are_doubted_where_the_sensors_sizes_are_known() -> None:
    places = {"thumb": (0.0, 0.0, 5.0), "index": (0.0, 3.0, 6.0)}
    assert judge_fingers(places, {}) is None
    name, found = judge_fingers(places, dict.fromkeys(places, 20.0)) or ("", None)
    assert (name, str(found)) == (
        "index",
        "found 3.2 mm from thumb, expected sensors that do not overlap, with x, y, z in mm: "
        "are they in cm?",
    )
    # Nobody has measured them yet.
    zero = dict.fromkeys(places, (0.0, 0.0, 0.0))
    assert judge_fingers(zero, dict.fromkeys(places, 20.0)) is None
    name, found = judge_fingers({"a": (0, 0, 50_000.0), "b": (0, 40_000.0, 0)}, {}) or ("", None)
    assert "are they in µm?" in str(found)
