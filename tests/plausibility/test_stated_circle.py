"""Circles that are stated in another way than as row, column and radius in px."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.stated_circle import Circle, CircleReading, judge_circle

HEIGHTS = st.sampled_from([240, 480, 720, 1080])


def visible(height_px: int, row: float, col: float, radius: float) -> Circle:
    """A circle in an image of this height, from parts of it."""
    return (height_px * row, height_px * col, height_px * radius)


@settings(max_examples=200, deadline=None)
@given(HEIGHTS, st.floats(0.3, 0.7), st.floats(0.3, 1.4), st.floats(0.2, 0.6), st.floats(0.8, 1.2))
def test_no_circle_is_suspected_that_is_near_what_the_image_shows(
    height_px: int, row: float, col: float, radius: float, factor: float
) -> None:
    row_px, col_px, radius_px = found = visible(height_px, row, col, radius)
    stated = (row_px + 0.1 * radius_px, col_px - 0.1 * radius_px, factor * radius_px)
    assert judge_circle(stated, found, height_px, 15.0) is None


WAYS: dict[CircleReading, Callable[[int, Circle], Circle]] = {
    CircleReading.SWAPPED: lambda h, c: (c[1], c[0], c[2]),
    CircleReading.FROM_BELOW: lambda h, c: (h - 1 - c[0], c[1], c[2]),
    CircleReading.SWAPPED_FROM_BELOW: lambda h, c: (c[1], h - 1 - c[0], c[2]),
    CircleReading.CORNER: lambda h, c: (c[0] - c[2], c[1] - c[2], c[2]),
    CircleReading.CORNER_SWAPPED: lambda h, c: (c[1] - c[2], c[0] - c[2], c[2]),
    CircleReading.OTHER_SIZE: lambda h, c: (c[0] / 2, c[1] / 2, c[2] / 2),
    CircleReading.MILLIMETRES: lambda h, c: (0.0, 0.0, 15.3),
}


@settings(max_examples=300, deadline=None)
@given(
    HEIGHTS,
    st.floats(0.3, 0.7),
    st.floats(0.5, 1.2),
    st.floats(0.3, 0.6),
    st.sampled_from(list(WAYS)),
    st.floats(-0.01, 0.01),
)
def test_another_way_of_stating_it_is_named_with_the_right_one(
    height_px: int, row: float, col: float, radius: float, way: CircleReading, off: float
) -> None:
    circle = visible(height_px, row, col, radius)
    row_px, col_px, radius_px = WAYS[way](height_px, circle)
    found = (circle[0] + off * circle[2], circle[1], circle[2] * (1 + off))
    # Near the diagonal, nobody sees it, and it does not matter.
    assume(max(abs(row_px - found[0]), abs(col_px - found[1])) > 0.3 * found[2])
    doubt = judge_circle((row_px, col_px, radius_px), found, height_px, 15.0)
    assert doubt is not None
    assert doubt.impossible
    assert f"row_px: {found[0]:.0f}, col_px: {found[1]:.0f}" in str(doubt)
    # Two ways may mean the same circle.
    others = [
        each
        for each in WAYS
        if each is not way
        and _apart(WAYS[each](height_px, circle), (row_px, col_px, radius_px)) < 0.3 * circle[2]
    ]
    assert doubt.values["reading"] is way or others


def _apart(one: Circle, other: Circle) -> float:
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ((320, 240, 205), "are row and column swapped?"),
        ((0, 0, 15.3), "is the radius in mm?"),
        ((118, 164, 102), "was it measured in an image of another size?"),
    ],
)
def test_the_question_ends_the_sentence(stated: Circle, said: str) -> None:
    found = (236.4, 327.6, 205.0)
    assert str(judge_circle(stated, found, 480, 15.3)) == (
        f"visible_circle: found row {stated[0]:g}, column {stated[1]:g}, radius {stated[2]:g}, "
        f"expected row_px: 236, col_px: 328, radius_px: 205 as the image shows: {said}"
    )
