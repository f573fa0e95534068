"""Find the visible circle and the marker pitch in a reference image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.calibration.reference.marker_field import find_markers
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.geometry.visible_circle import LEAST_RIM_SEEN, rim_seen
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import F32, F64, U8, Bool, Disc

# A smaller image shows no markers.
_LEAST_PX = 80
# Height of the image in which the coarse circle is searched for.
_SEARCH_ROWS = 120
# Vignetting weakens the rim's markers, and a LED ring has texture too: start from several parts of Otsu's threshold.
_TEXTURE_PARTS = (1.0, 0.5, 0.25)
# The rim of a region cut by the image: the part further than this from the border, with at least this many corners.
_BORDER_PX, _RIM_CORNERS = 4, 8
# A circle with at least this part of its rim in the image is not cut (a bright surround reaches the border, too).
_RIM_WHOLE = 0.97
_RAYS = 1440
_RADIAL_STEP_PX = 0.5
# Variation along the angle slower than this part of a turn is light (LED rings), not pattern.
_SLOW_TURN = 1 / 60
# Steps of the search for the centre, in px at a disc of 200 px.
_CENTRE_STEPS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.12)
# A pattern varies along the angle, just inside its rim, by at least this (RMS, grey levels).
_LEAST_PATTERN = 3.0
# The variation just outside the rim must be below this part of that just inside.
_RIM_FALL = 0.5
# Least part of the visible circle within a pitch of a marker (0.9 for a hexagon, 0.65 for a field as wide as the
# image). At the end of the texture the second is enough: the search misses some markers of a faint rim (0.52 is left on
# a coarse one). The circle of lamps around real domes with pins in their middle is filled by 0.26 to 0.36.
_FILLED, _HALF_FILLED = 0.75, 0.48


def visible_disc(grey: U8, stated: Disc | None) -> Disc:
    """The stated circle, or else the one found. Raises ConfigError like `find_disc`."""
    disc = stated or find_disc(grey)
    if not disc_mask(grey.shape[0], grey.shape[1], disc).any():
        found = f"a circle at row {disc.row_c:g}, col {disc.col_c:g} with radius {disc.radius_px:g} px"
        expected = f"expected a circle that overlaps the {grey.shape[1]}x{grey.shape[0]} px image"
        raise ConfigError(f"visible_circle: found {found}, {expected}")
    return disc


def find_disc(grey: U8) -> Disc:
    """Find the visible circle in a reference image.

    The disc holds the marker pattern, so its rim is where the pattern's variation along the angle ends: a step in
    brightness alone would find the LED ring instead. The textured region gives a coarse circle; a search then moves
    centre and radius to the sharpest end, as J. Daugman's integro-differential operator finds an iris (IEEE Trans. PAMI
    15, 1993). The markers themselves, if `marker_field` can find them one by one, must fill the disc.

    `grey`: uint8 (H, W). Raises ConfigError (the image has no circle with a marker pattern).
    """
    if min(grey.shape) < _LEAST_PX:
        found = f"the image is {grey.shape[1]}x{grey.shape[0]} px, expected at least {_LEAST_PX} px per side"
        raise ConfigError(f"found no visible circle in the reference: {found}")
    field = find_markers(grey)
    disc, refusal = None, ConfigError("found no visible circle in the reference")
    try:
        disc = _end_of_texture(grey)
    except ConfigError as error:
        refusal = error
    if field is None:
        if disc is None:
            raise refusal
        return disc
    if disc is not None and field.holds(disc) and field.filled_part(disc, grey.shape) >= _HALF_FILLED:
        return disc
    # A ring of lamps ends more sharply than the markers do. If the markers end at one circle, take it; if they do not,
    # like the corners of a hexagon of pins inside a wider dome, take the circle around them.
    near = _sharpest(grey, [field.circle])
    if not _refusal(grey, near) and field.holds(near.disc) and field.filled_part(near.disc, grey.shape) >= _FILLED:
        return near.disc
    whole = rim_seen(grey.shape, field.circle) >= _RIM_WHOLE  # an image full of pattern shows no circle
    if whole and field.filled_part(field.circle, grey.shape) >= _FILLED:
        return field.circle
    if disc is None:
        raise refusal
    return disc


def _end_of_texture(grey: U8) -> Disc:
    """The sharpest rim around the image's largest textured region."""
    regions = [_textured_region(grey, part) for part in _TEXTURE_PARTS]
    best = _sharpest(grey, [region.disc for region in regions])
    if _refusal(grey, best) or rim_seen(grey.shape, best.disc) < _RIM_WHOLE:
        cut = [region.rim for region in regions if region.rim and rim_seen(grey.shape, region.rim) > LEAST_RIM_SEEN]
        if cut:
            best = max(best, _sharpest(grey, cut), key=lambda rim: rim.sharpness)
    if reason := _refusal(grey, best):
        raise ConfigError(f"found no visible circle in the reference: {reason}")
    return best.disc


def _refusal(grey: U8, best: _Rim) -> str:
    """Why this is not the rim of a pattern; empty if it is."""
    if best.strength < _LEAST_PATTERN:
        return f"the pattern varies by {best.strength:.1f} grey levels, expected at least {_LEAST_PATTERN}"
    seen = rim_seen(grey.shape, best.disc)
    if seen < LEAST_RIM_SEEN:
        return f"{100 * seen:.0f} % of the best rim lies in the image, expected at least {100 * LEAST_RIM_SEEN:.0f} %"
    fall = _fall(grey, best.disc)
    if fall > _RIM_FALL:
        return (
            f"the pattern's variation falls only to {100 * fall:.0f} % across the best rim, "
            f"expected below {100 * _RIM_FALL:.0f} %"
        )
    return ""


def _fall(grey: U8, disc: Disc) -> float:
    """Variation along the angle just outside a circle over that just inside, on rays where the image holds both."""
    n = _width(disc)
    radii: F64 = disc.radius_px + _RADIAL_STEP_PX * np.arange(-n, n, dtype=np.float64)
    strength, seen = _pattern_strength(grey, disc, radii)
    both = strength[seen.all(axis=1)]
    if not len(both):
        return 1.0
    return float(np.sqrt(both[:, n:].mean() / max(both[:, :n].mean(), 1e-18)))


def _sharpest(grey: U8, starts: list[Disc]) -> _Rim:
    """The sharpest rim found from the best of the starting circles."""
    best = max((_end_of_pattern(grey, start, 0.5, 1.4) for start in starts), key=lambda rim: rim.sharpness)
    for step in _CENTRE_STEPS:
        best = _climb(grey, best, step * best.disc.radius_px / 200)
    return best


@dataclass(frozen=True, slots=True)
class _Rim:
    """A circle, the sharpness of the pattern's end there, and the variation just inside (grey levels)."""

    disc: Disc
    sharpness: float
    strength: float


def _climb(grey: U8, best: _Rim, step_px: float) -> _Rim:
    """Move the centre by `step_px` as long as the rim becomes sharper."""
    reach = 0.1 if step_px > 2 else 0.04
    best = _end_of_pattern(grey, best.disc, 1 - reach, 1 + reach)
    for _ in range(20):
        here = best
        for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            moved = Disc(here.disc.row_c + dr * step_px, here.disc.col_c + dc * step_px, here.disc.radius_px)
            tried = _end_of_pattern(grey, moved, 1 - reach, 1 + reach)
            if tried.sharpness > best.sharpness:
                best = tried
        if best is here:
            break
    return best


@dataclass(frozen=True, slots=True)
class _Region:
    """Circle of a region's area around its centroid; `rim` is one through its rim, if the image cuts the region."""

    disc: Disc
    rim: Disc | None


def _textured_region(grey: U8, part: float) -> _Region:
    """The hull of the largest region with more texture than `part` of Otsu's threshold (N. Otsu, 1979)."""
    scale = max(min(grey.shape) / _SEARCH_ROWS, 1.0)
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA).astype(np.float32)
    fine = cv2.absdiff(small, cv2.blur(small, (9, 9)))
    texture = cv2.blur(fine, (9, 9))
    level = np.clip(texture * (255 / max(float(texture.max()), 1e-6)), 0, 255).astype(np.uint8)
    split, _ = cv2.threshold(level, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, mask = cv2.threshold(level, part * split, 1, cv2.THRESH_BINARY)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((7, 7), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    if count < 2:
        raise ConfigError("found no circle with a marker pattern in the reference")
    best = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    contours, _ = cv2.findContours((labels == best).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.convexHull(max(contours, key=cv2.contourArea))
    area = cv2.contourArea(hull)
    moments = cv2.moments(hull)
    if area < 0.02 * small.size or moments["m00"] == 0:
        raise ConfigError(
            "found no circle with a marker pattern in the reference: the pattern covers too little of the image"
        )
    radius = float(np.sqrt(area / np.pi))
    disc = Disc(
        row_c=float(moments["m01"] / moments["m00"]) * scale,
        col_c=float(moments["m10"] / moments["m00"]) * scale,
        radius_px=radius * scale,
    )
    return _Region(disc, _circle_through_rim(hull[:, 0, ::-1].astype(np.float64), small.shape, scale))


def _circle_through_rim(hull: F64, shape: tuple[int, ...], scale: float) -> Disc | None:
    """Circle by least squares (I. Kåsa, 1976) through the hull's corners (row, col) off the border; None if not cut."""
    from_border = np.minimum(hull, np.array(shape) - 1 - hull).min(axis=1)
    rim = hull[from_border > _BORDER_PX]
    if from_border.min() > 0 or len(rim) < _RIM_CORNERS:
        return None
    unknowns = np.column_stack((2 * rim, np.ones(len(rim))))
    (row, col, rest), *_ = np.linalg.lstsq(unknowns, (rim * rim).sum(axis=1), rcond=None)
    square = rest + row * row + col * col
    return Disc(float(row) * scale, float(col) * scale, float(np.sqrt(square)) * scale) if square > 0 else None


def _width(disc: Disc) -> int:
    """The number of radial steps that count as just inside, or just outside, a rim."""
    return max(round(0.03 * disc.radius_px / _RADIAL_STEP_PX), 2)


def _pattern_strength(grey: U8, disc: Disc, radii: F64) -> tuple[F64, Bool]:
    """Squared variation along the angle at every radius, without its slow part. Returns `strength` (float64 (rays,
    radii)): in squared grey levels; 0 outside the image. Returns `seen` (bool (rays, radii)): whether the sample lies
    inside the image.
    """
    angles = 2 * np.pi * np.arange(_RAYS) / _RAYS
    cols = (disc.col_c + radii[None, :] * np.cos(angles)[:, None]).astype(np.float32)
    rows = (disc.row_c + radii[None, :] * np.sin(angles)[:, None]).astype(np.float32)
    polar = cv2.remap(grey, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    n = max(int(_RAYS * _SLOW_TURN), 1)
    slow = cv2.blur(np.vstack([polar[-n:], polar, polar[:n]]), (1, 2 * (n // 2) + 1))[n:-n]
    strength: F64 = ((polar - slow) ** 2).astype(np.float64)
    seen: Bool = (rows >= 0) & (rows <= grey.shape[0] - 1) & (cols >= 0) & (cols <= grey.shape[1] - 1)
    strength[~seen] = 0
    return strength, seen


def _end_of_pattern(grey: U8, disc: Disc, low: float, high: float) -> _Rim:
    """The rim at which the pattern ends, its radius `low` to `high` times the disc's.

    The profile averages all angles, so a marker that ends short of the rim does not matter; a wrong centre smears the
    end, so the right one has the greatest sharpness.
    """
    n = _width(disc)
    radii = np.arange(low * disc.radius_px - n * _RADIAL_STEP_PX, high * disc.radius_px, _RADIAL_STEP_PX)
    profile = np.sqrt(_pattern_strength(grey, disc, radii)[0].mean(axis=0))
    mean = np.convolve(profile, np.ones(n) / n, "valid")  # mean[i] covers i .. i+n-1
    inner, outer = mean[:-n], mean[n:]
    if inner.size == 0 or not inner.max() > 0:
        raise ConfigError("found no visible circle in the reference: the pattern fills the image")
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
    return _Rim(
        Disc(disc.row_c, disc.col_c, radius),
        sharpness=float(fall[best]),
        strength=float(inner[best]),
    )


def marker_pitch_px(grey: U8, disc: Disc) -> float:
    """Distance between neighbouring pin tips in the middle of the disc, px. Raises ConfigError (the disc has no
    periodic pattern).
    """
    try:
        return _spectral_pitch_px(grey, disc)
    except ConfigError:
        field = find_markers(grey)
        if field is None or field.filled_part(disc, grey.shape) < _HALF_FILLED:
            raise
        return field.pitch_px


def _spectral_pitch_px(grey: U8, disc: Disc) -> float:
    """The marker pitch from the pattern's spectrum, px.

    The first ring of the lattice's spectrum lies at 2 / (√3 pitch): the first peak of the mean power over all
    directions in the middle of the disc, where perspective stretches the lattice least.
    """
    half = max(int(0.5 * disc.radius_px), 8)
    row, col = round(disc.row_c), round(disc.col_c)
    patch = grey[max(row - half, 0) : row + half, max(col - half, 0) : col + half].astype(np.float32)
    patch = patch - cv2.blur(patch, (2 * (half // 3) + 1, 2 * (half // 3) + 1))
    window = np.hanning(patch.shape[0])[:, None] * np.hanning(patch.shape[1])[None, :]
    size = 1024
    power = np.abs(np.fft.rfft2(patch * window, s=(size, size))) ** 2
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    bins = np.minimum((frequency * size).astype(int), size // 2)
    ring = np.bincount(bins.ravel(), weights=power.ravel()) / np.maximum(np.bincount(bins.ravel()), 1)
    low, high = int(size * 4 / half), int(size * 0.25)
    band = ring[low:high]
    if band.size < 8 or not band.max() > 0:
        raise ConfigError("found no marker pattern in the reference: the visible circle is too small")
    smooth = np.convolve(band, np.ones(5) / 5, "same")
    peaks = np.flatnonzero((smooth[1:-1] >= smooth[:-2]) & (smooth[1:-1] > smooth[2:])) + 1
    strong = [int(p) for p in peaks if smooth[p] >= 0.3 * smooth.max()]
    if not strong or smooth.max() < 5 * np.median(smooth):
        raise ConfigError("found no marker pattern in the reference: the image's spectrum has no clear ring")
    first = strong[0]  # the lowest strong ring, because a honeycomb's second ring can be stronger
    near = slice(max(first - 4, 0), first + 5)
    weights = smooth[near]
    peak = float((weights * np.arange(band.size)[near]).sum() / weights.sum()) + low + 0.5
    return float(2 / np.sqrt(3) * size / peak)


def mean_image(images: Sequence[U8]) -> U8:
    """Rounded mean of equally sized grey images."""
    total: F32 = np.zeros(images[0].shape, dtype=np.float32)
    for image in images:
        total += image
    mean: U8 = np.rint(total / len(images)).astype(np.uint8)
    return mean
