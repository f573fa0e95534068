"""How a sensor at rest looks beside its calibration's reference: its light, its markers' white, and
where its pins stand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.sensor.frame_check import camera_drift
from tacshade_edge.sensor.geometry.disc import DiscRays, disc_mask, skin_planes
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.types import F32, F64, U8, Bool, Calibration, Disc

# Squares of this side show dark and white alike, wherever the lattice lies in them. These parts of
# their pixels are below the two levels, after a blur that takes noise, which would part them.
_SQUARE_PITCHES, _BLUR_PITCHES = 2.0, 0.125
_DARK_PART, _WHITE_PART = 0.15, 0.85
_LEAST_SQUARES, _LEAST_POINTS = 6, 20
# A place has another pattern if the correlation with the reference's, over a square of two pitches
# around it, is below this: on one that is only dimmer, faded or sunk it is 0.95 or more.
_LEAST_ALIKE, _REACH = 0.8, 0.95
# Leaving out points that lie off by this many deviations, so often, leaves the common motion.
_TURNS, _DEVIATIONS, _MAD = 5, 3.0, 1.4826
_LEAST_PX, _LEAST_LEVEL = 0.02, 0.01  # deviations of points, and of levels, that hardly vary
_SINK_MM = 0.1  # by which the skin is sunk to see how it would look
# The length of pins, and the housing's edge in visible half angles or radii: as sensors are built.
_PIN_PITCHES, _RIM = 1.7, 1.45


@dataclass(frozen=True, slots=True)
class Appearance:
    """How a sensor at rest differs from its calibration's reference; all 0 for one that does not.

    `white` and `dark` are logarithms of the ratio of their grey levels, in the middle of the disc;
    `slope_row` and `slope_col` by how much that of the white grows over a radius of the disc.
    `sunk_mm`: by how much the tip of the skin has sunk, as the pattern narrows or widens beyond
    what a camera's zoom explains; within a factor of two, since that depends on the length of pins
    and on where the skin is held. `bent_part`: the part of the disc that shows another pattern,
    beyond all this motion: its pins stand aside, or something covers them.
    """

    white: float
    dark: float
    slope_row: float
    slope_col: float
    sunk_mm: float
    bent_part: float


def appearance(calibration: Calibration, images: Sequence[U8]) -> Appearance | None:
    """Compare untouched images (at least one) with a calibration's reference; None if they do not
    show enough of its pattern.
    """
    greys = [greyscale.to_grey(image) for image in images]
    mean: F32 = np.asarray(np.mean(greys, axis=0, dtype=np.float32))
    light = _light(calibration, mean)
    if light is None:
        return None
    even = _evened(light, calibration.geometry.disc, mean)
    motion = _motion(calibration, np.rint(np.clip(even, 0, 255)).astype(np.uint8))
    if motion is None:
        return None
    rows, cols = _pixels(mean)
    col_px, row_px = np.tensordot(motion.astype(np.float32), _ways(calibration, cols, rows), 1)
    there = cv2.remap(even, cols + col_px, rows + row_px, cv2.INTER_LINEAR)
    return Appearance(
        light.white,
        light.dark,
        light.slope_row,
        light.slope_col,
        float(motion[-1]),
        _changed_part(calibration, np.asarray(there, np.float32)),
    )


@dataclass(frozen=True, slots=True)
class _Light:
    """The first four values of `Appearance`, and the white and the dark level of the reference."""

    white: float
    dark: float
    slope_row: float
    slope_col: float
    white_grey: float
    dark_grey: float


def _light(calibration: Calibration, mean: F32) -> _Light | None:
    """The light of a mean picture, float32 (H, W); None if the disc is too small to show it."""
    disc, pitch_px = calibration.geometry.disc, calibration.pitch_px
    side = max(round(_SQUARE_PITCHES * pitch_px), 2)
    old, new = (
        _dark_and_white(grey, side, pitch_px)
        for grey in (calibration.reference_grey.astype(np.float32), mean)
    )
    rows, cols = (side * (np.arange(count) + 0.5) - 0.5 for count in old.shape[1:])
    row, col = _from_centre(disc, *np.meshgrid(rows, cols, indexing="ij"))
    # Whole squares only: what surrounds the disc has its own light.
    inside = np.hypot(row, col) <= 1 - side * 0.7072 / disc.radius_px
    if np.count_nonzero(inside) < _LEAST_SQUARES:
        return None
    dark, white = np.log(new[:, inside] / old[:, inside])
    plane: F64 = np.stack((np.ones(len(white)), row[inside], col[inside]), axis=1)
    middle, slope_row, slope_col = _fitted(plane, white.astype(np.float64), _LEAST_LEVEL)
    dark_grey, white_grey = np.median(old[:, inside], axis=1)
    return _Light(
        float(middle),
        float(np.median(dark)),
        float(slope_row),
        float(slope_col),
        float(white_grey),
        float(dark_grey),
    )


def _evened(light: _Light, disc: Disc, mean: F32) -> F32:
    """A picture in the light and with the contrast of the reference, since what tracks points takes
    others for movement.
    """
    row, col = _from_centre(disc, *_pixels(mean))
    lit = mean * np.exp(-(light.white + light.slope_row * row + light.slope_col * col))
    dark_grey = light.dark_grey * math.exp(light.dark - light.white)
    gain = (light.white_grey - light.dark_grey) / max(light.white_grey - dark_grey, 1.0)
    return np.asarray(light.white_grey + gain * (lit - light.white_grey), np.float32)


def _pixels(image: F32) -> tuple[F32, F32]:
    """The row and the column of each pixel, (H, W)."""
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    return rows, cols


def _dark_and_white(grey: F32, side: int, pitch_px: float) -> F32:
    """The dark and the white level of each square, (2, rows, cols); at least 1."""
    smooth = cv2.GaussianBlur(grey, (0, 0), _BLUR_PITCHES * pitch_px)
    rows, cols = smooth.shape[0] // side, smooth.shape[1] // side
    squares = smooth[: rows * side, : cols * side].reshape(rows, side, cols, side)
    pixels = squares.swapaxes(1, 2).reshape(rows, cols, -1)
    at = [round(part * (side * side - 1)) for part in (_DARK_PART, _WHITE_PART)]
    levels = np.partition(pixels, at, axis=2)[..., at]
    return np.asarray(np.maximum(np.moveaxis(levels, 2, 0), 1), np.float32)


def _from_centre(disc: Disc, rows: F32, cols: F32) -> tuple[F32, F32]:
    """Rows and columns from the middle of the disc, in its radii."""
    row, col = (rows - disc.row_c) / disc.radius_px, (cols - disc.col_c) / disc.radius_px
    return np.asarray(row, np.float32), np.asarray(col, np.float32)


def _motion(calibration: Calibration, grey: U8) -> F64 | None:
    """How much of each of `_ways` the pattern moved; None if it cannot be followed."""
    look = camera_drift.look(
        calibration.reference_grey, calibration.geometry.disc, calibration.pitch_px
    )
    before, after = camera_drift.tracked(look, grey)
    if len(before) < _LEAST_POINTS:
        return None
    ways = _ways(calibration, before[:, 0], before[:, 1])
    moved_px = (after - before).T.ravel()
    return _fitted(
        ways.reshape(len(ways), -1).T.astype(np.float64), moved_px.astype(np.float64), _LEAST_PX
    )


def _ways(calibration: Calibration, cols: F32, rows: F32) -> F32:
    """How places of the picture move, columns and rows, (ways, 2, ...), px: by a shift along
    columns, one along rows, a turn and, on a dome, a zoom, each by a pixel at the edge of the disc;
    last by a tip that sinks by a mm.
    """
    row, col = _from_centre(calibration.geometry.disc, rows, cols)
    one, zero = np.ones_like(row), np.zeros_like(row)
    ways = [one, zero, zero, one, -row, col]
    # A pad that sinks looks as from nearer, which is a zoom: both are a wrong distance to the lens.
    if calibration.geometry.skin == "dome":
        ways += [col, row]
    moved = np.stack(ways).reshape(len(ways) // 2, 2, *row.shape)
    return np.concatenate((moved, _sinking_px(calibration, cols, rows)[None]))


def _changed_part(calibration: Calibration, there: F32) -> float:
    """`Appearance.bent_part` of a picture, float32 (H, W), after the common motion."""
    disc, old = calibration.geometry.disc, calibration.reference_grey.astype(np.float32)
    side = max(round(_SQUARE_PITCHES * calibration.pitch_px), 2)

    def mean(values: F32) -> F32:
        return np.asarray(cv2.blur(values, (side, side)), np.float32)

    # Pearson's correlation on the square around each pixel.
    first, second = mean(old), mean(there)
    both = mean(old * there) - first * second
    spread = (mean(old * old) - first**2) * (mean(there * there) - second**2)
    alike = both / np.sqrt(np.maximum(spread, 1))
    reach = replace(disc, radius_px=_REACH * disc.radius_px - side / 2)
    inside = disc_mask(old.shape[0], old.shape[1], reach)
    return float(np.mean(alike[inside] < _LEAST_ALIKE)) if inside.any() else 0.0


def _sinking_px(calibration: Calibration, cols: F32, rows: F32) -> F32:
    """How far places of the picture move, columns and rows, (2, ...), for each mm by which the tip
    of the skin sinks. The housing holds the skin; pins, of whose tips most is seen, turn with it.
    """
    geometry, d = calibration.geometry, calibration.geometry.camera_distance_mm
    disc = geometry.disc
    pin_mm = _PIN_PITCHES * calibration.pitch_px * geometry.mm_per_px
    off = np.stack((cols - disc.col_c, rows - disc.row_c)).astype(np.float32)
    per_px = geometry.mm_per_px if d is None else 1 / geometry.f_px
    u, v = off * np.float32(per_px)
    rays = DiscRays(np.ones(u.shape, bool), u, v)
    x, y, z = skin_planes(np.full_like(u, pin_mm), rays, geometry)
    if geometry.skin == "pad":
        rim2 = (_RIM * geometry.visible_radius_mm) ** 2
        up = 1 - (x * x + y * y) / rim2
        outwards = 2 * pin_mm / rim2
        x, y, z = x * (1 + _SINK_MM * outwards), y * (1 + _SINK_MM * outwards), z - _SINK_MM * up
    else:
        r = geometry.skin_radius_mm
        low = math.cos(math.radians(min(_RIM * geometry.visible_half_angle_deg, 90)))
        cosine = z / (r - pin_mm)
        up = (cosine - low) / (1 - low)
        # The skin becomes flatter by this slope over the sine of the angle from its tip.
        turn = pin_mm * _SINK_MM / ((1 - low) * r)
        along = 1 - _SINK_MM * up / (r - pin_mm) + turn * cosine / (r - pin_mm)
        x, y, z = x * along, y * along, z * along - turn
    px = 1 / per_px if d is None else geometry.f_px / (z + d)
    return np.asarray((np.stack((x, y)) * px - off) / _SINK_MM, np.float32)


def _fitted(terms: F64, values: F64, least: float) -> F64:
    """The weights (K,) of terms (N, K) that most of the values (N,) follow; those off by three
    deviations, which are at least `least`, do not count.
    """
    kept: Bool = np.ones(len(values), bool)
    found: F64 = np.zeros(terms.shape[1])
    for _ in range(_TURNS):
        found = np.asarray(np.linalg.lstsq(terms[kept], values[kept], rcond=None)[0])
        off = np.abs(values - terms @ found)
        deviation = max(_MAD * float(np.median(off[kept])), least)
        kept = off <= _DEVIATIONS * deviation
    return found
