"""Find the visible circle and the marker pitch in a reference image,
and judge how well an image shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.reference.marker_field import MarkerField, find_markers
from tacshade_edge.calibration.sentences import circle_to_state
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.frame_check.picture import SATURATED_LEVEL
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.types import F64, U8, Bool, Disc

# A smaller image shows no markers.
_LEAST_PX = 80
_NOT_FOUND = "found no visible circle in the reference"
# Height of the image in which the coarse circle is searched for.
_SEARCH_ROWS = 120
# Vignetting weakens the rim's markers, and a LED ring has texture too:
# start from several parts of Otsu's threshold.
_TEXTURE_PARTS = (1.0, 0.5, 0.25)
# The rim of a region cut by the image: the part further than this from the border,
# with at least this many corners.
_BORDER_PX, _RIM_CORNERS = 4, 8
# A circle with at least this part of its rim in the image is not cut
# (a bright surround reaches the border, too).
_RIM_WHOLE = 0.97
_RAYS = 1440
_RADIAL_STEP_PX = 0.5
# Variation along the angle slower than this part of a turn is light (LED rings), not pattern.
_SLOW_TURN = 1 / 60
# Steps of the search for the centre, in px at a disc of 200 px.
_CENTRE_STEPS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.12)
# A pattern varies along the angle, just inside its rim, by at least this (RMS, grey levels).
_LEAST_PATTERN = 3.0
# In a sector that shows the rim's end, the variation just inside is at least this part of the
# median sector's, and that just outside at most this part of that inside. True rims end in 0.62 or
# more of the sectors (0.7 to 1 in whole images), wrong ones and the corners of a hexagon in 0.5 or
# less.
_SECTORS, _PATTERN_PART, _RIM_FALL, _ENDING = 24, 0.35, 0.6, 0.6
# If it ends in this part, and has at least this part of the radius of the circle around the
# markers, what looks like markers beyond it is lamps.
_SURE, _LAMPS = 0.85, 0.75
_LEAST_SECTORS = 10
# The outer part of a field and what is beside it, in radii of the circle around it,
# by as many radii.
_BESIDE, _BESIDE_RADII = (0.8, 1.1), 16
# A refused circle is the likeliest one if it ends in this part; else the one around the markers is.
_GUESSED = 0.35
# Least part of the visible circle within a pitch of a marker (0.9 for a hexagon, 0.65 for a field
# as wide as the image). At the end of the texture the second is enough: the search misses some
# markers of a faint rim (0.52 is left on a coarse one, 0.39 on a dome seen orthographically). The
# circle of lamps around real domes with pins in their middle is filled by 0.26 to 0.36, and the
# pins end before it.
_FILLED, _HALF_FILLED = 0.75, 0.37
# A stated circle holds at least this part of the markers:
# true ones hold all, those a tenth too small 0.9 or more.
_STATED_PART = 0.85


# Least part of the rim in the image; with less, the pattern ends at the image's own border.
_LEAST_RIM_SEEN = 0.25


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


class CircleNotFoundError(ConfigError):
    """No circle is certain; `guess` is the likeliest one, None if the image shows no pattern."""

    def __init__(self, text: str, guess: Disc | None = None) -> None:
        super().__init__(text)
        self.guess = guess


def visible_disc(grey: U8, stated: Disc | None) -> Disc:
    """The stated circle, or else the one found.

    Raises ConfigError with the line of SENSOR.yaml that states the likeliest.
    """
    try:
        disc = stated or find_disc(grey)
    except CircleNotFoundError as error:
        advice = circle_to_state(error.guess) if error.guess else ""
        raise CircleNotFoundError(f"{error}{advice}", error.guess) from None
    if not disc_mask(grey.shape[0], grey.shape[1], disc).any():
        found = (
            f"a circle at row {disc.row_c:g}, col {disc.col_c:g} with radius {disc.radius_px:g} px"
        )
        expected = f"expected a circle that overlaps the {grey.shape[1]}x{grey.shape[0]} px image"
        raise ConfigError(f"visible_circle: found {found}, {expected}")
    return disc


def found_circle_doubt(grey: U8, disc: Disc) -> CalibrationFinding | None:
    """That a found circle bounds the markers, but no rim is seen to cut the pattern;
    None if one is.
    """
    if _ending_part(grey, disc) >= _ENDING:
        return None
    return finding(FindingCode.NO_RIM, circle=disc)


def stated_circle_doubt(grey: U8, disc: Disc) -> CalibrationFinding | None:
    """That a stated circle leaves out many markers, as by a wrong digit or swapped axes;
    None if it does not.
    """
    field = find_markers(grey)
    if not field or field.holds(disc, _STATED_PART):
        return None
    return finding(FindingCode.MARKERS_OUTSIDE, percent=100 * (1 - _STATED_PART))


def find_disc(grey: U8) -> Disc:
    """Find the visible circle.

    Its rim is where the pattern's variation along the angle ends: a step in brightness would find
    the LED ring. Regions of texture give coarse circles, from which a search moves to the sharpest
    end (J. Daugman, IEEE Trans. PAMI 15, 1993). Markers must fill the disc; pins that no rim cuts
    end at the circle around them. Raises CircleNotFoundError.
    """
    if min(grey.shape) < _LEAST_PX:
        found = (
            f"the image is {grey.shape[1]}x{grey.shape[0]} px, "
            f"expected at least {_LEAST_PX} px per side"
        )
        raise CircleNotFoundError(f"{_NOT_FOUND}: {found}")
    field = find_markers(grey)
    rims = [rim for starts in _starts(grey, field) if (rim := _sharpest(grey, starts))]
    if not rims:
        raise CircleNotFoundError(
            f"{_NOT_FOUND}: the pattern covers too little or all of the image"
        )
    pitch_px = field.pitch_px if field else 0.0
    endings = [_ending_part(grey, rim.disc, pitch_px) for rim in rims]
    good = [
        rim
        for rim, ending in zip(rims, endings, strict=True)
        if _is_visible_circle(grey, rim, ending, field)
    ]
    if good:
        return max(
            good, key=lambda rim: (_filled(grey, rim.disc, field) >= _FILLED, rim.sharpness)
        ).disc
    whole = (
        field and rim_seen(grey.shape, field.circle) >= _RIM_WHOLE
    )  # an image full of pattern shows no circle
    if field and whole and _filled(grey, field.circle, field) >= _FILLED:
        return field.circle
    ending, best = max(zip(endings, rims, strict=True), key=lambda each: each[0])
    found = (
        f"markers fill {100 * _filled(grey, best.disc, field):.0f} % of the best circle and end "
        "along"
    )
    guess = field.circle if field and ending < _GUESSED else best.disc
    raise CircleNotFoundError(f"{_NOT_FOUND}: {found} {100 * ending:.0f} % of its rim", guess)


def _filled(grey: U8, disc: Disc, field: MarkerField | None) -> float:
    return field.filled_part(disc, grey.shape) if field else 1.0


def _is_visible_circle(grey: U8, rim: _Rim, ending: float, field: MarkerField | None) -> bool:
    """Whether a rim, along a part of which the pattern ends, can be the visible circle's."""
    if (
        rim.strength < _LEAST_PATTERN
        or ending < _ENDING
        or rim_seen(grey.shape, rim.disc) < _LEAST_RIM_SEEN
    ):
        return False
    if field is None:
        return True
    larger = rim.disc.radius_px / field.circle.radius_px
    if _filled(grey, rim.disc, field) < _HALF_FILLED or (
        larger > _BESIDE[1] and _is_isolated(grey, field)
    ):
        return False
    return field.holds(rim.disc) or (ending >= _SURE and larger >= _LAMPS)


def _starts(grey: U8, field: MarkerField | None) -> list[list[Disc]]:
    """Coarse circles: around regions of texture, through the rims of cut ones,
    and around the markers.
    """
    regions = [region for part in _TEXTURE_PARTS if (region := _textured_region(grey, part))]
    rims = [rim for _, rim in regions if rim]
    around = []
    if field:
        around.append(field.circle)
        if rim := _circle_through_rim(field.hull_px, grey.shape, field.pitch_px):
            rims.append(replace(rim, radius_px=rim.radius_px + field.pitch_px / 2))
    cut = [rim for rim in rims if rim_seen(grey.shape, rim) > _LEAST_RIM_SEEN]
    return [starts for starts in ([disc for disc, _ in regions], cut, around) if starts]


def _ending_part(grey: U8, disc: Disc, pitch_px: float = 0.0) -> float:
    """Part of a circle's sectors in the image, 0 to 1, in which the pattern ends at the circle,
    for half a pitch.
    """
    n = _width(disc)
    radii: F64 = disc.radius_px + _RADIAL_STEP_PX * np.arange(
        -n, max(n, pitch_px / 2 / _RADIAL_STEP_PX)
    )
    strength, seen = _pattern_strength(grey, disc, radii)
    rays = seen.all(axis=1).reshape(_SECTORS, -1)
    shown = rays.mean(axis=1) >= 0.5
    if not shown.any():
        return 0.0
    sectors = strength.reshape(_SECTORS, -1, len(radii))[shown]
    weight = rays[shown] / rays[shown].sum(axis=1, keepdims=True)
    inner, outer = (
        np.sqrt((part.mean(axis=2) * weight).sum(axis=1)) for part in np.split(sectors, [n], axis=2)
    )
    ends = (inner >= max(_PATTERN_PART * float(np.median(inner)), _LEAST_PATTERN)) & (
        outer <= _RIM_FALL * inner
    )
    # A few sectors may agree by chance.
    return float(np.count_nonzero(ends) / max(len(ends), _LEAST_SECTORS))


def _is_isolated(grey: U8, field: MarkerField) -> bool:
    """Whether a pattern ends with a field: beside it,
    the image varies under a third as much (0.47 on coarse rims).
    """
    radii: F64 = field.circle.radius_px * np.linspace(*_BESIDE, 3 * _BESIDE_RADII)
    strength, seen = _pattern_strength(grey, field.circle, radii)
    rms = np.sqrt(strength.sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    return bool(rms[-_BESIDE_RADII:].mean() < 0.3 * rms[:_BESIDE_RADII].mean())


def _sharpest(grey: U8, starts: list[Disc]) -> _Rim | None:
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
class _Rim:
    """A circle, the sharpness of the pattern's end there,
    and the variation just inside (grey levels).
    """

    disc: Disc
    sharpness: float
    strength: float


def _climb(grey: U8, best: _Rim, step_px: float) -> _Rim:
    """Move the centre by `step_px` as long as the rim becomes sharper."""
    reach = 0.1 if step_px > 2 else 0.04
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


def _textured_region(grey: U8, part: float) -> tuple[Disc, Disc | None] | None:
    """The circle of the area of the largest region with more texture than a part of Otsu's
    threshold (1979), and one through its rim if the image cuts it; None if it is too small.
    """
    from skimage import measure  # a daemon that takes no reference does not need it

    scale = max(min(grey.shape) / _SEARCH_ROWS, 1.0)
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA).astype(
        np.float32
    )
    fine = cv2.absdiff(small, cv2.blur(small, (9, 9)))
    texture = cv2.blur(fine, (9, 9))
    level = np.clip(texture * (255 / max(float(texture.max()), 1e-6)), 0, 255).astype(np.uint8)
    split, _ = cv2.threshold(level, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, mask = cv2.threshold(level, part * split, 1, cv2.THRESH_BINARY)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((7, 7), np.uint8))
    regions = measure.regionprops(measure.label(mask, connectivity=1))
    if not regions:
        return None
    places = max(regions, key=lambda region: region.area).coords
    hull = cv2.convexHull(places[:, ::-1].astype(np.int32))
    area = cv2.contourArea(hull)
    moments = cv2.moments(hull)
    if area < 0.02 * small.size or moments["m00"] == 0:
        return None
    row, col = (float(moments[name] / moments["m00"]) * scale for name in ("m01", "m10"))
    disc = Disc(row, col, float(np.sqrt(area / np.pi)) * scale)
    return disc, _circle_through_rim(
        hull[:, 0, ::-1].astype(np.float64), small.shape, _BORDER_PX, scale
    )


def _circle_through_rim(
    hull: F64, shape: tuple[int, ...], border_px: float, scale: float = 1.0
) -> Disc | None:
    """Circle by least squares through the hull's corners (row, col) off the border;
    None if not cut.
    """
    from_border = np.minimum(hull, np.array(shape) - 1 - hull).min(axis=1)
    rim = hull[from_border > border_px]
    if from_border.min() > border_px or len(rim) < _RIM_CORNERS:
        return None
    from skimage.measure import CircleModel  # 10 MB, which whole images do not need

    circle = CircleModel.from_estimate(rim)
    if not circle:
        return None
    row, col = circle.center
    return Disc(float(row) * scale, float(col) * scale, float(circle.radius) * scale)


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
    strength[~seen] = 0
    return strength, seen


def _end_of_pattern(grey: U8, disc: Disc, low: float, high: float) -> _Rim | None:
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
    return _Rim(Disc(disc.row_c, disc.col_c, radius), float(fall[best]), float(inner[best]))


def marker_pitch_px(grey: U8, disc: Disc) -> float:
    """Distance between neighbouring pin tips in the middle of the disc, px.

    Raises ConfigError without a pattern.
    """
    try:
        return _spectral_pitch_px(grey, disc)
    except ConfigError:
        field = find_markers(grey)
        if field is None or field.filled_part(disc, grey.shape) < _HALF_FILLED:
            raise
        return field.pitch_px


def _spectral_pitch_px(grey: U8, disc: Disc) -> float:
    """The marker pitch from the pattern's spectrum, px: the lattice's first ring lies at 2 / (√3
    pitch), in the mean power over all directions in the middle of the disc, where perspective
    stretches it least.
    """
    half = max(int(0.5 * disc.radius_px), 8)
    row, col = round(disc.row_c), round(disc.col_c)
    patch = grey[max(row - half, 0) : row + half, max(col - half, 0) : col + half].astype(
        np.float32
    )
    patch = patch - cv2.blur(patch, (2 * (half // 3) + 1, 2 * (half // 3) + 1))
    window = np.hanning(patch.shape[0])[:, None] * np.hanning(patch.shape[1])[None, :]
    size = 1024
    power = np.abs(np.fft.rfft2(patch * window, s=(size, size))) ** 2
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    bins = np.minimum((frequency * size).astype(int), size // 2)
    ring = np.bincount(bins.ravel(), weights=power.ravel()) / np.maximum(
        np.bincount(bins.ravel()), 1
    )
    low, high = int(size * 4 / half), int(size * 0.25)
    band = ring[low:high]
    if band.size < 8 or not band.max() > 0:
        raise ConfigError(
            "found no marker pattern in the reference: the visible circle is too small"
        )
    smooth = np.convolve(band, np.ones(5) / 5, "same")
    peaks = np.flatnonzero((smooth[1:-1] >= smooth[:-2]) & (smooth[1:-1] > smooth[2:])) + 1
    strong = [int(p) for p in peaks if smooth[p] >= 0.3 * smooth.max()]
    if not strong or smooth.max() < 5 * np.median(smooth):
        raise ConfigError(
            "found no marker pattern in the reference: the image's spectrum has no clear ring"
        )
    first = strong[0]  # the lowest strong ring, because a honeycomb's second ring can be stronger
    near = slice(max(first - 4, 0), first + 5)
    weights = smooth[near]
    peak = float((weights * np.arange(band.size)[near]).sum() / weights.sum()) + low + 0.5
    return float(2 / np.sqrt(3) * size / peak)


def mean_image(images: Sequence[U8]) -> U8:
    """Rounded mean of equally sized grey images."""
    return np.rint(np.mean(images, axis=0, dtype=np.float32)).astype(np.uint8)


# Rows of the image in which the circle is searched for: a third of the time, and within 1 px.
_PATTERN_ROWS = 240
# Part of the radius that is measured, without the housing's edge.
_INNER = 0.95
_PERCENTILES = (5, 95)
_SATURATED_PART, _CONTRAST_GREY = 0.02, 30.0


@dataclass(frozen=True, slots=True)
class Pattern:
    """The disc of the marker pattern in an image, and its pitch in px."""

    disc: Disc
    pitch_px: float


@dataclass(frozen=True, slots=True)
class PatternView:
    """How well an image shows the pattern."""

    # RMS of the Laplacian over the pattern's: greatest when sharpest (Subbarao,
    # Choi and Nikzad 1993).
    focus: float
    contrast_grey: float  # of the markers: 5th to 95th percentile, without slow variation of light
    saturated_part: float  # of the disc, at 250 grey levels or above

    @property
    def advice(self) -> str:
        """What to fix; empty if nothing."""
        if self.saturated_part > _SATURATED_PART:
            return "too bright: use less light or a shorter exposure"
        if self.contrast_grey < _CONTRAST_GREY:
            return "too flat: use more light, a longer exposure or a sharper lens"
        return ""


def find_pattern(grey: U8, stated: Disc | None = None) -> Pattern:
    """Find the disc, if it is not stated, and the pitch.

    Raises ConfigError if the image shows none.
    """
    if stated is not None:
        return Pattern(visible_disc(grey, stated), marker_pitch_px(grey, stated))
    scale = max(grey.shape[0] / _PATTERN_ROWS, 1.0)
    if min(grey.shape) < 16 * scale:
        raise ConfigError(
            "found no visible circle: the image is too small or too narrow "
            f"({grey.shape[1]}x{grey.shape[0]} px)"
        )
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    disc = find_disc(np.asarray(small, np.uint8))
    # Pixel centres are whole numbers: resizing keeps the image's corners, not its first pixel.
    row_c, col_c = ((centre + 0.5) * scale - 0.5 for centre in (disc.row_c, disc.col_c))
    found = Disc(row_c, col_c, disc.radius_px * scale)
    return Pattern(found, marker_pitch_px(grey, found))


def view(grey: U8, pattern: Pattern) -> PatternView:
    """Measure how well an image shows the pattern of this image or an earlier one."""
    disc, (height, width) = pattern.disc, grey.shape
    inside = disc_mask(height, width, Disc(disc.row_c, disc.col_c, _INNER * disc.radius_px))
    if not inside.any():
        return PatternView(0.0, 0.0, 0.0)
    values = grey.astype(np.float32)
    side = max(int(2 * pattern.pitch_px) | 1, 3)
    detail = (values - cv2.blur(values, (side, side)))[inside]
    fine = cv2.Laplacian(cv2.GaussianBlur(values, (0, 0), 1.0), cv2.CV_32F)[inside]
    low, high = np.percentile(detail, _PERCENTILES)
    return PatternView(
        focus=float(fine.std() / max(detail.std(), 1e-3)),
        contrast_grey=float(high - low),
        saturated_part=float(np.mean(grey[inside] >= SATURATED_LEVEL)),
    )
