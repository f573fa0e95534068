"""The visible circle of pictures that show it badly: found, warned of, or refused with the line that states it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.calibrated_sensor import HALF, TACTIP

from tacshade_edge.core.calibration.reference.pattern import rim_warning, visible_disc
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.render import Print, Renderer, print_features
from tacshade_edge.simulator.skin import undeformed
from tacshade_edge.types import F64, U8, Bool, Disc

DARK = replace(TACTIP, surround="dark")
STATED = re.compile(r"visible_circle: \{row_px: (-?\d+), col_px: (-?\d+), radius_px: (\d+)\}")


@cache
def picture(model: SensorModel, keep: Callable[[F64], Bool] | None = None) -> U8:
    """The unloaded skin, with the features of the print that `keep` keeps by their places in the skin's chart."""
    marks = print_features(model)
    if keep is not None:
        markers, pins = keep(marks.marker_chart_mm.mean(axis=1)), keep(marks.pin_chart_mm)
        sizes = (size[pins] for size in (marks.pin_base_mm, marks.pin_tip_mm, marks.pin_length_mm))
        marks = Print(marks.marker_chart_mm[markers], marks.pin_chart_mm[pins], *sizes)
    renderer = Renderer(model, marks)
    return to_grey(renderer.expose(renderer.draw(undeformed(model.skin_radius_mm)), 0))


def cut(model: SensorModel, edges: str, part: float) -> tuple[U8, Disc]:
    """A picture whose top, bottom, left or right edge cuts off this part of the radius, and the true circle."""
    grey, reach = picture(model), (1 - part) * model.disc_radius_px
    top, left = (
        max(round(at - reach), 0) if edge in edges else 0 for at, edge in ((model.row_c, "t"), (model.col_c, "l"))
    )
    bottom = round(model.row_c + reach) + 1 if "b" in edges else None
    right = round(model.col_c + reach) + 1 if "r" in edges else None
    return np.ascontiguousarray(grey[top:bottom, left:right]), Disc(
        model.row_c - top, model.col_c - left, model.disc_radius_px
    )


def wide(model: SensorModel) -> tuple[U8, Disc]:
    """A picture of which the disc takes 40 % of the height."""
    side = round(model.disc_radius_px / 0.4 - picture(model).shape[0] / 2)
    grey = cv2.copyMakeBorder(picture(model), side, side, side, side, cv2.BORDER_CONSTANT, value=10)
    return np.asarray(grey, np.uint8), Disc(model.row_c + side, model.col_c + side, model.disc_radius_px)


def thresholded(model: SensorModel) -> tuple[U8, Disc]:
    """A near-binary picture, black beside the disc."""
    grey, disc = picture(model), model.geometry.disc
    side = 2 * int(disc.radius_px / 8) + 1
    white = cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, side, -8)
    at = np.hypot(*(np.indices(grey.shape) - np.array((disc.row_c, disc.col_c))[:, None, None]))
    return np.where(at < disc.radius_px, white, 0).astype(np.uint8), disc


def hexagon(
    rings: int, pitch_px: float, pin_px: float, *, lamps: bool = False, binary: bool = False
) -> tuple[U8, Disc]:
    """White pins without a rim, and the circle around them, half a pitch wider; `lamps`: a bright ring beyond."""
    shape, row_c, col_c = (480, 640), 236.7, 325.2
    at = np.hypot(*(np.indices(shape) - np.array((row_c, col_c))[:, None, None]))
    disc = Disc(row_c, col_c, (rings + 0.5) * pitch_px)
    steps, pins = range(-rings, rings + 1), np.zeros(shape, np.float32)
    for b, a in ((b, a) for b in steps for a in steps if abs(a + b) <= rings):
        row, col = row_c + b * pitch_px * 3**0.5 / 2, col_c + (a + b / 2) * pitch_px
        cv2.circle(pins, (round(16 * col), round(16 * row)), round(16 * pin_px), 1.0, -1, cv2.LINE_AA, 4)
    ring = np.where((at > 1.25 * disc.radius_px) & (at < 1.6 * disc.radius_px), 190.0, 0.0) if lamps else 0.0
    image = (
        20 + ring + 150 * cv2.GaussianBlur(pins, (0, 0), 1.2) * np.maximum(1 - 0.5 * (at / disc.radius_px) ** 2, 0.2)
    )
    grey = np.clip(image + np.random.default_rng(0).normal(0, 2.5, shape), 0, 255).astype(np.uint8)
    return np.where(grey > 70, np.uint8(255), np.uint8(0)) if binary else grey, disc


def error(found: Disc, true: Disc) -> float:
    """How far a circle is off, in radii."""
    beside = np.hypot(found.row_c - true.row_c, found.col_c - true.col_c)
    return float(max(beside, abs(found.radius_px - true.radius_px)) / true.radius_px)


def answer(grey: U8, true: Disc) -> tuple[str, float]:
    """What becomes of a picture, found, warned or refused, and the error of that circle (NaN: none)."""
    try:
        found = visible_disc(grey, None)
    except ConfigError as refusal:
        numbers = STATED.search(str(refusal))
        return "refused", error(Disc(*map(float, numbers.groups())), true) if numbers else np.nan
    return "warned" if rim_warning(grey, found) else "found", error(found, true)


FOUND = {
    **{f"cut {edges} by {part:.0%}": cut(HALF, edges, part) for edges in ("t", "tl", "lr") for part in (0.05, 0.3)},
    **{f"cut {edges} by 20%, no ring": cut(DARK, edges, 0.2) for edges in ("b", "tb", "tl")},
    "cut tblr by 5%, no ring": cut(DARK, "tblr", 0.05),
    "wide margins": wide(HALF),
    "wide margins, no ring": wide(DARK),
    "near-binary": thresholded(DARK),
}
BARE = {
    "19 pins": hexagon(2, 61, 16),
    "37 pins": hexagon(3, 46, 12),
    "37 pins, near-binary": hexagon(3, 46, 12, binary=True),
    "61 pins in a ring": hexagon(4, 36, 9, lamps=True),
    "127 pins in a ring": hexagon(6, 26, 4.5, lamps=True),
    "127 small pins": hexagon(6, 20, 1.5),
}
REFUSED = {
    "cut tblr by 20%": cut(DARK, "tblr", 0.2),
    "half of the dome is printed": (picture(DARK, lambda at: at[:, 1] < 0), DARK.geometry.disc),
    "the middle rows are printed": (picture(HALF, lambda at: np.abs(at[:, 1]) < 8), HALF.geometry.disc),
}


@pytest.mark.parametrize("name", FOUND)
def test_a_badly_shown_circle_is_found(name: str) -> None:
    said, off = answer(*FOUND[name])
    assert (said, off < 0.02) == ("found", True), off


@pytest.mark.parametrize("name", BARE)
def test_the_circle_around_pins_that_no_rim_ends_is_found_with_a_warning(name: str) -> None:
    said, off = answer(*BARE[name])
    assert (said, off < 0.02) == ("warned", True), off


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_suggests_a_circle(name: str) -> None:
    said, off = answer(*REFUSED[name])
    assert (said, off < 0.1) == ("refused", True), off


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    model=st.sampled_from((HALF, DARK)),
    edges=st.sampled_from(("t", "r", "tb", "bl", "tbr", "tblr")),
    part=st.floats(0.02, 0.35),
    noise_grey=st.floats(0, 6),
    blur_px=st.floats(0.1, 2.5),
    gain=st.floats(0.2, 1.2),
)
def test_a_wrong_circle_is_never_found_silently(
    model: SensorModel, edges: str, part: float, noise_grey: float, blur_px: float, gain: float
) -> None:
    grey, true = cut(model, edges, part)
    seen = gain * cv2.GaussianBlur(grey.astype(np.float32), (0, 0), blur_px)
    seen += np.random.default_rng(1).normal(0, noise_grey, grey.shape)
    said, off = answer(np.clip(seen, 0, 255).astype(np.uint8), true)
    assert said != "found" or off < 0.04  # 256 of 260 within 0.02; more noise in a burnt surround: 0.09
