"""Part a connected contact into the objects that touch one another in it, by k-means.

Between two objects the skin is free, or nearly: the network's log odds of contact have a valley
there, even where the heights have none. As the odds that are asked for rise, such a contact falls
apart into lobes, which are the seeds of k-means. A long, bent or branched object may have lobes
too, but without a deep valley, a narrow neck, or parts that are more convex than the whole:
`evidence` weighs all three for any two parts. A convex contact is one object, which its outline
shows at once. Without a network, the distance from the outline stands for the odds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from tacshade_edge.types import F32, F64, I32, I64, U8, Bool

CONVEX_PART = 0.92  # least part of its hull that a convex contact covers, by cells
PARTS_MAX = 8
LOBE_CELLS, LOBE_MM = 2.0, 1.2  # least inscribed radius of a lobe: less is noise of the outline
CONTOUR_CELLS = 20  # length of the contour of two such lobes; shorter ones are not examined
PEAK_CELLS = 5  # least number of cells of a lobe above its valley: fewer are noise
VALLEY = 0.85  # least depth of a valley, in log odds: no gain makes up for a shallower one
# Log odds, without a network, of a distance from the outline that is e times another.
DISTANCE_ODDS = 3.0
NECK_ODDS = 6.0  # log odds that a neck is worth whose half width is 1 / e of a lobe's radius
GAIN_ODDS = 4.0  # log odds that a full gain in convexity is worth
EVIDENCE = 7.0  # least `evidence` that two parts are two objects
LEVELS = 20
SIDE_CELLS = 120  # greatest side of the box of a contact that is examined cell by cell
NORMAL_MM = 2.0  # length of a unit normal beside x, y and z
STEPS_MAX = 5
LEAST_NECK_CELLS = 0.5  # half the width of a cell
_AROUND = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class Lobe:
    """A part of a contact above a valley: its innermost cell, its inscribed radius in cells, the
    valley's depth in log odds.
    """

    row: int
    col: int
    radius: float
    valley: float


def part_objects(
    raw: I32, count: int, planes_mm: F32, area_mm2: F32, contact_logit: F32 | None
) -> int:
    """Give each further object in a connected contact the next number in `raw`, (rows, cols)
    numbers below `count` of connected contacts, 0 outside; return the count then. `planes_mm` are
    x, y and z, (3, rows, cols), `area_mm2` is each cell's, and `contact_logit` its log odds of
    contact, if they are known.
    """
    # One search for all contacts: connected by 8 neighbours, no two share a contour. Every cell of
    # it is kept, because Pick's theorem counts them.
    contours, _ = cv2.findContours(
        (raw > 0).view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    for contour in contours:
        if len(contour) < CONTOUR_CELLS or covered_part(contour) >= CONVEX_PART:
            continue
        col, row, width, height = cv2.boundingRect(contour)
        box = slice(row, row + height), slice(col, col + width)
        own = raw[box] == raw[contour[0, 0, 1], contour[0, 0, 0]]
        logit = None if contact_logit is None else contact_logit[box]
        # A map without a network may have a cell for every pixel:
        # 100 on a side show an object's form.
        step = 1 + max(width, height) // SIDE_CELLS
        some = slice(None, None, step), slice(None, None, step)
        parts = parts_of(
            own[some],
            planes_mm[(slice(None), *box)][(slice(None), *some)],
            step * step * area_mm2[box][some],
            None if logit is None else np.ascontiguousarray(logit[some]),
        )
        if parts is None:
            continue
        parts = np.where(own, _finer(parts, own[some], step)[:height, :width], 0)
        raw[box][parts > 0] = count - 1 + parts[parts > 0]
        count += int(parts.max())
    return count


def _finer(parts: I64, own: Bool, step: int) -> I64:
    """Numbers of coarse cells at the fine ones; those at the edge
    of a contact have their neighbour's number.
    """
    if step == 1:
        return parts
    numbers = np.where(own, parts + 1, 0).astype(np.uint16)
    grown = np.where(own, numbers, cv2.dilate(numbers, _AROUND))
    fine = grown.repeat(step, axis=0).repeat(step, axis=1).astype(np.int64)
    return np.maximum(fine - 1, 0)


def covered_part(contour: I32) -> float:
    """The part of its convex hull that a contour's cells, with those of its holes, cover."""
    # A contour runs through the middles of its cells, so its area lacks half a cell all around:
    # half of the outline's cells and one more belong to it (Pick's theorem).
    cells = cv2.contourArea(contour) + len(contour) / 2 + 1
    return float(cells / _cells_in(cv2.convexHull(contour)))


def _cells_in(hull: I32) -> float:
    return float(cv2.contourArea(hull) + cv2.arcLength(hull, closed=True) / 2 + 1)


def parts_of(own: Bool, planes_mm: F32, area_mm2: F32, contact_logit: F32 | None) -> I64 | None:
    """The number of the object, from 0, of each cell in a contact, 0 elsewhere;
    None if it is one object.
    """
    cell_mm = math.sqrt(float(area_mm2[own].mean()))
    # A distance is measured to the nearest 0, and beyond the array there is none: without a border,
    # a contact at its edge would have no outline there.
    edged = cv2.copyMakeBorder(own.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    inner = cv2.distanceTransform(edged, cv2.DIST_L2, 5)[1:-1, 1:-1]
    least_cells = max(LOBE_CELLS, LOBE_MM / max(cell_mm, 1e-9))
    found = list(seeds(own, inner, contact_logit, least_cells))
    if not found:
        return None
    rows, cols = np.nonzero(own)
    places = np.stack((cols, rows), axis=1).astype(np.int32)
    point_of = np.zeros(own.shape, np.int64)
    point_of[rows, cols] = np.arange(len(rows))
    x = features(planes_mm)[:, rows, cols].T
    best, best_score = None, -1.0
    for lobes in found:
        at = [point_of[one.row, one.col] for one in lobes]
        radii_mm = cell_mm * np.array([one.radius for one in lobes])
        assigned, centres = k_means(x, x[at], radii_mm)
        if evidence(lobes, places, assigned, inner) < EVIDENCE:
            continue
        score = silhouette(x, assigned, centres)
        if score > best_score:
            best, best_score = assigned, score
    if best is None:
        return None
    parts = np.zeros(own.shape, np.int64)
    parts[rows, cols] = best
    return parts


def features(planes_mm: F32) -> F64:
    """x, y and z in mm and the unit normal, which is `NORMAL_MM` long, (6, rows, cols)."""
    planes = planes_mm.astype(np.float64)
    along, across = np.gradient(planes, axis=2), np.gradient(planes, axis=1)
    normal = np.cross(along, across, axis=0)
    length = np.maximum(np.sqrt((normal * normal).sum(axis=0)), 1e-9)
    made: F64 = np.nan_to_num(np.concatenate((planes, NORMAL_MM * normal / length)))
    return made


def seeds(
    own: Bool, inner: F32, contact_logit: F32 | None, least_cells: float
) -> Iterator[Sequence[Lobe]]:
    """The lobes, at least `least_cells` in radius, into which a contact falls apart: two or more,
    for each number of lobes those above the lowest level. `inner` is each cell's distance from the
    outline, in cells.
    """
    if contact_logit is None:
        known = DISTANCE_ODDS * np.log(np.maximum(inner, np.float32(1)))
    else:
        # A dip of a single cell is no valley.
        known = cv2.blur(contact_logit, (3, 3))
    odds: F32 = np.where(own, known, -np.inf).astype(np.float32)
    lowest, highest = float(odds[own].min()), float(odds.max())
    levels = [lowest + (highest - lowest) * step / LEVELS for step in range(1, LEVELS)]
    # Every third level crosses a valley that is deep enough: most contacts need no more.
    if all(len(_lobes(odds, inner, level, least_cells)) <= 1 for level in levels[1::3]):
        return
    seen = {0, 1}
    for level in levels:
        lobes = _lobes(odds, inner, level, least_cells)
        if len(lobes) not in seen and len(lobes) <= PARTS_MAX:
            seen.add(len(lobes))
            yield lobes


def _lobes(odds: F32, inner: F32, level: float, least_cells: float) -> list[Lobe]:
    """The lobes above a level that are at least `least_cells` in radius and `VALLEY` high;
    none if there is one.
    """
    count, lobe_of, boxes, _ = cv2.connectedComponentsWithStats(
        (odds > level).view(np.uint8), connectivity=8
    )
    large = [k for k in range(1, count) if boxes[k, cv2.CC_STAT_AREA] >= PEAK_CELLS]
    if len(large) <= 1:
        return []
    lobes = []
    for number in large:
        inside = np.where(lobe_of == number, inner, 0)
        row, col = np.unravel_index(int(inside.argmax()), inside.shape)
        valley = float(odds[lobe_of == number].max()) - level
        lobe = Lobe(int(row), int(col), float(inside[row, col]), valley)
        if lobe.radius >= least_cells and lobe.valley >= VALLEY:
            lobes.append(lobe)
    return lobes


def k_means(x: F64, start: F64, radii_mm: F64) -> tuple[I64, F64]:
    """Lloyd's k-means of points (N, D) from k centres (k, D), with the clusters' squared radii
    taken off the squared distances, so that a small cluster beside a large one ends where their
    circles meet. Returns each point's cluster, and the centres.
    """
    # Less the mean, so that little cancels in the squares below.
    origin = x.mean(axis=0)
    points, centres = x - origin, start - origin
    doubled = 2 * points
    assigned = np.full(len(x), -1)
    for _ in range(STEPS_MAX):
        # The points' own squares are the same for every centre, and are left out of the comparison.
        offset = radii_mm * radii_mm - (centres * centres).sum(axis=1)
        nearest = (doubled @ centres.T + offset).argmax(axis=1)
        if (nearest == assigned).all():
            break
        assigned = nearest
        members = assigned[:, None] == np.arange(len(start))
        counts = members.sum(axis=0)
        kept = counts > 0
        centres[kept] = (members.T.astype(np.float64) @ points)[kept] / counts[kept, None]
    return assigned, centres + origin


def silhouette(x: F64, assigned: I64, centres: F64) -> float:
    """Mean silhouette of points (N, D), from distances to the clusters' centres."""
    # To the centres, not between all pairs of points, which would take their number squared.
    apart = np.linalg.norm(x[:, None] - centres, axis=2)
    own = np.take_along_axis(apart, assigned[:, None], axis=1)[:, 0]
    np.put_along_axis(apart, assigned[:, None], np.inf, axis=1)
    other = apart.min(axis=1)
    return float(((other - own) / np.maximum(np.maximum(own, other), 1e-9)).mean())


def evidence(lobes: Sequence[Lobe], places: I32, assigned: I64, inner: F32) -> float:
    """How much speaks for several objects, the least over any two parts, in log odds: the depth of
    the valley, the narrowness of the neck, and the gain in convexity, which is 1 if the parts' own
    hulls leave out all that is wasted in their common hull.
    """
    parts = [places[assigned == number] for number in range(len(lobes))]
    if not all(map(len, parts)):
        return 0.0
    hulls = [cv2.convexHull(_ends_of_rows(part)) for part in parts]
    wasted = [_cells_in(hull) - len(part) for hull, part in zip(hulls, parts, strict=True)]
    masks = [_mask(part, inner) for part in parts]
    least = math.inf
    for i, j in combinations(range(len(lobes)), 2):
        common = cv2.convexHull(np.concatenate((hulls[i], hulls[j])))
        common_waste = _cells_in(common) - len(parts[i]) - len(parts[j])
        # Less than a cell of waste is the outline's rounding.
        gain = 1 - (wasted[i] + wasted[j]) / max(common_waste, 1.0)
        meeting = inner[(cv2.dilate(masks[i], _AROUND) & masks[j]).view(bool)]
        neck = math.log(
            min(lobes[i].radius, lobes[j].radius) / float(meeting.max(initial=LEAST_NECK_CELLS))
        )
        valley = min(lobes[i].valley, lobes[j].valley)
        least = min(least, valley + NECK_ODDS * max(neck, 0.0) + GAIN_ODDS * gain)
    return least


def _ends_of_rows(places: I32) -> I32:
    """The first and the last of each row of places (N, 2), which come row by row:
    these alone can be in a hull.
    """
    first = np.flatnonzero(np.diff(places[:, 1], prepend=-1))
    return np.concatenate((places[first], places[np.append(first[1:], len(places)) - 1]))


def _mask(places: I32, inner: F32) -> U8:
    mask = np.zeros(inner.shape, np.uint8)
    mask[places[:, 1], places[:, 0]] = 1
    return mask
