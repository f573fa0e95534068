"""Where a pattern ends along a circle: how sharply, in which part of its rim, and beside what."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.calibration.reference.marker_field import MarkerField
from tacshade_edge.types import F64, U8, Bool, Disc

# A multiple of the sectors; one ray for each px of a rim with a radius of 230 px.
_RAYS = 1440
_RADIAL_STEP_PX = 0.5
# Variation along the angle slower than this part of a turn is light (LED rings), not pattern.
_SLOW_TURN = 1 / 60
# Steps of the search for the centre, in px at a disc of 200 px.
_CENTRE_STEPS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.12)
# A pattern varies along the angle, just inside its rim, by at least this (RMS, grey levels).
LEAST_PATTERN = 3.0
# In a sector that shows the rim's end, the variation just inside is at least this part of the
# median sector's, and that just outside at most this part of that inside. True rims end in 0.62 or
# more of the sectors (0.7 to 1 in whole images), wrong ones and the corners of a hexagon in 0.5 or
# less.
_SECTORS, _PATTERN_PART, _RIM_FALL, ENDING = 24, 0.35, 0.6, 0.6
# Steps up to this many px try radii in a narrower range: the coarse ones have found it by then.
_FINE_PX, _REACH, _FINE_REACH = 2.0, 0.1, 0.04
# A sector counts if the image shows at least this part of its rays on both sides of the rim.
_SHOWN_PART = 0.5
# Fewer may agree by chance.
_LEAST_SECTORS = 10
# The outer part of a field and what is beside it, in radii of the circle around it,
# by as many radii.
BESIDE, _BESIDE_RADII = (0.8, 1.1), 16


def rim_seen(shape: tuple[int, ...], disc: Disc) -> float:
    """Part of a circle's rim, 0 to 1, that lies in an image of a shape (rows, cols)."""
    angles = 2 * np.pi * np.arange(_RAYS) / _RAYS
    rows, cols = (
        disc.row_c + disc.radius_px * np.sin(angles),
        disc.col_c + disc.radius_px * np.cos(angles),
    )
    return float(
        np.mean((rows >= 0) & (rows <= shape[0] - 1) & (cols >= 0) & (cols <= shape[1] - 1))
    )


def ending_part(grey: U8, disc: Disc, pitch_px: float = 0.0) -> float:
    """Part of a circle's sectors in the image, 0 to 1, in which the pattern ends at the circle,
    for half a pitch.
    """
    n = _width(disc)
    radii: F64 = disc.radius_px + _RADIAL_STEP_PX * np.arange(
        -n, max(n, pitch_px / 2 / _RADIAL_STEP_PX)
    )
    strength, seen = _pattern_strength(grey, disc, radii)
    rays = seen.all(axis=1).reshape(_SECTORS, -1)
    shown = rays.mean(axis=1) >= _SHOWN_PART
    if not shown.any():
        return 0.0
    sectors = strength.reshape(_SECTORS, -1, len(radii))[shown]
    weight = rays[shown] / rays[shown].sum(axis=1, keepdims=True)
    inner, outer = (
        np.sqrt((part.mean(axis=2) * weight).sum(axis=1)) for part in np.split(sectors, [n], axis=2)
    )
    ends = (inner >= max(_PATTERN_PART * float(np.median(inner)), LEAST_PATTERN)) & (
        outer <= _RIM_FALL * inner
    )
    return float(np.count_nonzero(ends) / max(len(ends), _LEAST_SECTORS))


def is_isolated(grey: U8, field: MarkerField) -> bool:
    """Whether a pattern ends with a field: beside it,
    the image varies under a third as much (0.47 on coarse rims).
    """
    radii: F64 = field.circle.radius_px * np.linspace(*BESIDE, 3 * _BESIDE_RADII)
    strength, seen = _pattern_strength(grey, field.circle, radii)
    rms = np.sqrt(strength.sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    return bool(rms[-_BESIDE_RADII:].mean() < 0.3 * rms[:_BESIDE_RADII].mean())


def sharpest(grey: U8, starts: list[Disc]) -> Rim | None:
    """The sharpest rim found from the best of the starting circles;
    None if the pattern fills the image.
    """
    rims = [rim for start in starts if (rim := _end_of_pattern(grey, start, 0.5, 1.4))]
    if not rims:
        return None
    best = max(rims, key=lambda rim: rim.sharpness)
    for step in _CENTRE_STEPS:
        best = _climb(grey, best, step * best.disc.radius_px / 200)
    return best


@dataclass(frozen=True, slots=True)
class Rim:
    """A circle, the sharpness of the pattern's end there,
    and the variation just inside (grey levels).
    """

    disc: Disc
    sharpness: float
    strength: float


def _climb(grey: U8, best: Rim, step_px: float) -> Rim:
    """Move the centre by `step_px` as long as the rim becomes sharper."""
    reach = _REACH if step_px > _FINE_PX else _FINE_REACH
    # At each scale the radius first: a wrong one hides which centre is better.
    best = _end_of_pattern(grey, best.disc, 1 - reach, 1 + reach) or best
    for _ in range(20):
        here = best
        for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            moved = Disc(
                here.disc.row_c + dr * step_px, here.disc.col_c + dc * step_px, here.disc.radius_px
            )
            tried = _end_of_pattern(grey, moved, 1 - reach, 1 + reach)
            if tried and tried.sharpness > best.sharpness:
                best = tried
        if best is here:
            break
    return best


def _width(disc: Disc) -> int:
    """The number of radial steps that count as just inside, or just outside, a rim."""
    return max(round(0.03 * disc.radius_px / _RADIAL_STEP_PX), 2)


def _pattern_strength(grey: U8, disc: Disc, radii: F64) -> tuple[F64, Bool]:
    """Squared variation along the angle at every radius, without its slow part, grey levels², and
    whether the sample lies inside the image, both (rays, radii); 0 outside.
    """
    angles = 2 * np.pi * np.arange(_RAYS) / _RAYS
    cols = (disc.col_c + radii[None, :] * np.cos(angles)[:, None]).astype(np.float32)
    rows = (disc.row_c + radii[None, :] * np.sin(angles)[:, None]).astype(np.float32)
    polar = cv2.remap(grey, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(
        np.float32
    )
    n = max(int(_RAYS * _SLOW_TURN), 1)
    slow = cv2.blur(np.vstack([polar[-n:], polar, polar[:n]]), (1, 2 * (n // 2) + 1))[n:-n]
    strength: F64 = ((polar - slow) ** 2).astype(np.float64)
    seen: Bool = (
        (rows >= 0) & (rows <= grey.shape[0] - 1) & (cols >= 0) & (cols <= grey.shape[1] - 1)
    )
    # Outside, `BORDER_REPLICATE` makes stripes, which are no pattern.
    strength[~seen] = 0
    return strength, seen


def _end_of_pattern(grey: U8, disc: Disc, low: float, high: float) -> Rim | None:
    """The rim at which the pattern ends, `low` to `high` times the disc's radius; None without
    pattern. The profile averages all angles: a wrong centre smears the end, so the right one has
    the greatest sharpness.
    """
    n = _width(disc)
    radii = np.arange(
        low * disc.radius_px - n * _RADIAL_STEP_PX, high * disc.radius_px, _RADIAL_STEP_PX
    )
    profile = np.sqrt(_pattern_strength(grey, disc, radii)[0].mean(axis=0))
    mean = np.convolve(profile, np.ones(n) / n, "valid")  # mean[i] covers i .. i+n-1
    inner, outer = mean[:-n], mean[n:]
    if inner.size == 0 or not inner.max() > 0:
        return None
    # Weight a fall to nothing above a larger fall from one row of markers to the next.
    fall = inner * (inner - outer) / (outer + 0.05 * inner.max())
    best = int(np.argmax(fall))
    edge = best + n
    # Interpolate the radius at half of the fall.
    half = (profile[edge - n : edge].mean() + profile[edge : edge + n].mean()) / 2
    below = np.flatnonzero(profile[edge - n : edge + n] < half)
    k = edge - n + int(below[0]) if below.size else edge
    part = (profile[k - 1] - half) / max(profile[k - 1] - profile[k], 1e-9) if k > 0 else 0.0
    radius = float(radii[k] - _RADIAL_STEP_PX * (1 - min(max(part, 0.0), 1.0)))
    return Rim(Disc(disc.row_c, disc.col_c, radius), float(fall[best]), float(inner[best]))
