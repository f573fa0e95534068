"""Find the visible circle in a reference image, or judge a stated one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.reference.marker_field import MarkerField, find_markers
from tacshade_edge.calibration.reference.rim import (
    BESIDE,
    ENDING,
    LEAST_PATTERN,
    Rim,
    ending_part,
    is_isolated,
    rim_seen,
    sharpest,
)
from tacshade_edge.calibration.sentences import circle_to_state
from tacshade_edge.errors import ConfigError
from tacshade_edge.plausibility.stated_circle import judge_circle
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.types import F64, U8, Disc

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
# If it ends in this part, and has at least this part of the radius of the circle around the
# markers, what looks like markers beyond it is lamps.
_SURE, _LAMPS = 0.85, 0.75
# A refused circle is the likeliest one if it ends in this part; else the one around the markers is.
_GUESSED = 0.35
# Least part of the visible circle within a pitch of a marker (0.9 for a hexagon, 0.65 for a field
# as wide as the image). At the end of the texture the second is enough: the search misses some
# markers of a faint rim (0.52 is left on a coarse one, 0.39 on a dome seen orthographically). The
# circle of lamps around real domes with pins in their middle is filled by 0.26 to 0.36, and the
# pins end before it.
_FILLED, HALF_FILLED = 0.75, 0.37
# A stated circle holds at least this part of the markers:
# true ones hold all, those a tenth too small 0.9 or more.
_STATED_PART = 0.85
# Least part of the rim in the image; with less, the pattern ends at the image's own border.
_LEAST_RIM_SEEN = 0.25


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
    # A stated circle may be of another image size.
    if not disc_mask(grey.shape[0], grey.shape[1], disc).any():
        found = (
            f"a circle at row {disc.row_c:g}, col {disc.col_c:g} with radius {disc.radius_px:g} px"
        )
        expected = f"expected a circle that overlaps the {grey.shape[1]}x{grey.shape[0]} px image"
        raise ConfigError(f"visible_circle: found {found}, {expected}")
    return disc


def other_statement(grey: U8, stated: Disc, radius_mm: float) -> CalibrationFinding | None:
    """That a stated circle leaves out markers, and is the one that the image shows if it is read
    otherwise; None if it does not, or is not. `radius_mm` is that of the circle on the skin.
    """
    field = find_markers(grey)
    if not field or field.holds(stated, _STATED_PART):
        return None
    try:
        found = find_disc(grey)
    except CircleNotFoundError as error:
        if error.guess is None:
            return None
        found = error.guess
    doubt = judge_circle(_circle(stated), _circle(found), grey.shape[0], radius_mm)
    return finding(FindingCode.CIRCLE_STATED, suspicion=doubt) if doubt else None


def found_circle_doubt(grey: U8, disc: Disc) -> CalibrationFinding | None:
    """That a found circle bounds the markers, but no rim is seen to cut the pattern;
    None if one is.
    """
    if ending_part(grey, disc) >= ENDING:
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


def _circle(disc: Disc) -> tuple[float, float, float]:
    return disc.row_c, disc.col_c, disc.radius_px


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
    rims = [rim for starts in _starts(grey, field) if (rim := sharpest(grey, starts))]
    if not rims:
        raise CircleNotFoundError(
            f"{_NOT_FOUND}: the pattern covers too little or all of the image"
        )
    pitch_px = field.pitch_px if field else 0.0
    endings = [ending_part(grey, rim.disc, pitch_px) for rim in rims]
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
    # Refused, but the likeliest one helps whoever states it.
    ending, best = max(zip(endings, rims, strict=True), key=lambda each: each[0])
    found = (
        f"markers fill {100 * _filled(grey, best.disc, field):.0f} % of the best circle and end "
        "along"
    )
    guess = field.circle if field and ending < _GUESSED else best.disc
    raise CircleNotFoundError(f"{_NOT_FOUND}: {found} {100 * ending:.0f} % of its rim", guess)


def _filled(grey: U8, disc: Disc, field: MarkerField | None) -> float:
    return field.filled_part(disc, grey.shape) if field else 1.0


def _is_visible_circle(grey: U8, rim: Rim, ending: float, field: MarkerField | None) -> bool:
    """Whether a rim, along a part of which the pattern ends, can be the visible circle's."""
    if (
        rim.strength < LEAST_PATTERN
        or ending < ENDING
        or rim_seen(grey.shape, rim.disc) < _LEAST_RIM_SEEN
    ):
        return False
    if field is None:
        return True
    larger = rim.disc.radius_px / field.circle.radius_px
    if _filled(grey, rim.disc, field) < HALF_FILLED or (
        larger > BESIDE[1] and is_isolated(grey, field)
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
    # Groups of starts, each with a winner: a ring of lamps ends more sharply than the markers do.
    cut = [rim for rim in rims if rim_seen(grey.shape, rim) > _LEAST_RIM_SEEN]
    return [starts for starts in ([disc for disc, _ in regions], cut, around) if starts]


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
    # Opened, because threads of texture join the disc to lamps and screws.
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
    circle = circle_by_least_squares(rim)
    return circle and Disc(*(each * scale for each in circle))


def circle_by_least_squares(points: F64) -> tuple[float, float, float] | None:
    """Row, column and radius of the circle whose equation the points (N, 2) fit best; None for
    points on a line.

    The circle is linear in (row, col, r² - row² - col²). That of scikit-image 0.26 calls what SciPy
    removes.
    """
    middle, scale = points.mean(axis=0), points.std()
    if scale == 0:
        return None
    # Around their middle and of size 1: places far from the corner would cost digits.
    units = (points - middle) / scale
    terms = np.column_stack([2 * units, np.ones(len(units))])
    solved, _, rank, _ = np.linalg.lstsq(terms, (units**2).sum(axis=1), rcond=None)
    if rank < terms.shape[1]:
        return None
    row, col = solved[:2] * scale + middle
    radius = np.sqrt(((points - (row, col)) ** 2).sum(axis=1).mean())
    return float(row), float(col), float(radius)
