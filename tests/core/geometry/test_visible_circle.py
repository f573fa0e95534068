from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.geometry.visible_circle import (
    LEAST_APART,
    LEAST_RADIUS_PX,
    LEAST_RIM_SEEN,
    circle_through,
    rim_seen,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Disc

SHAPE = (480, 640)


def rim(disc: Disc, *degrees: float) -> list[tuple[float, float]]:
    angles = [math.radians(angle) for angle in degrees]
    return [
        (disc.row_c + disc.radius_px * math.sin(angle), disc.col_c + disc.radius_px * math.cos(angle))
        for angle in angles
    ]


@given(
    row=st.floats(210, 270),
    col=st.floats(210, 430),
    radius=st.floats(LEAST_RADIUS_PX + 1, 200),
    first=st.floats(0, 360),
    second=st.floats(35, 150),
    third=st.floats(35, 150),
)
def test_it_is_the_circle_whose_rim_was_clicked(
    row: float, col: float, radius: float, first: float, second: float, third: float
) -> None:
    disc = Disc(row, col, radius)
    found = circle_through(rim(disc, first, first + second, first + second + third), SHAPE)
    assert (found.row_c, found.col_c, found.radius_px) == pytest.approx((row, col, radius), abs=1e-6)


PIXEL = st.tuples(st.floats(-0.5, SHAPE[0] - 0.5), st.floats(-0.5, SHAPE[1] - 0.5))


@given(st.lists(PIXEL, min_size=3, max_size=3))
def test_whatever_is_clicked_is_refused_or_a_circle_through_it(points: list[tuple[float, float]]) -> None:
    try:
        disc = circle_through(points, SHAPE)
    except ConfigError:
        with pytest.raises(ConfigError, match=r"^three points: found [^\n]+, expected [^\n]+$"):
            circle_through(points, SHAPE)
        return
    assert disc.radius_px >= LEAST_RADIUS_PX
    assert rim_seen(SHAPE, disc) >= LEAST_RIM_SEEN
    for k, (row, col) in enumerate(points):
        assert math.hypot(row - disc.row_c, col - disc.col_c) == pytest.approx(disc.radius_px)
        assert math.dist((row, col), points[k - 1]) >= LEAST_APART * disc.radius_px


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([(10, 10), (100, 100), (190, 190)], "points on one line"),
        ([(10, 10), (10, 10), (190, 190)], "points on one line"),
        ([(10, 10), (10, 10), (10, 10)], "points on one line"),
        (
            rim(Disc(240, 320, 200), 0, 20, 180),
            "a distance of only 69 px between two points, expected at least 0.5 times the circle's radius of 200 px",
        ),
        (rim(Disc(240, 320, 20), 0, 120, 240), "a circle with a radius of 20 px, expected at least 33 px"),
        (rim(Disc(240, -230, 280), -30, 0, 30), "a circle with 19 % of its rim in the image, expected at least 25 %"),
        ([(-1, 10), (100, 100), (190, 10)], "a point at row -1, col 10, expected a point inside the 640x480 px image"),
    ],
)
def test_clicks_that_make_no_circle_are_one_line(points: list[tuple[float, float]], said: str) -> None:
    with pytest.raises(ConfigError) as refused:
        circle_through(points, SHAPE)
    assert str(refused.value).startswith(f"three points: found {said}")


def test_of_a_circle_that_the_image_cuts_the_part_inside_counts() -> None:
    assert rim_seen(SHAPE, Disc(240, 320, 200)) == 1
    assert rim_seen(SHAPE, Disc(-0.0, 320, 200)) == pytest.approx(0.5, abs=0.01)
    assert rim_seen(SHAPE, Disc(-300, 320, 200)) == 0
