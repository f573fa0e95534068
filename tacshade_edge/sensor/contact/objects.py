"""Make object clouds: the contact, one label for every object,
and a plane and a planar motion for each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import add
from typing import Any

import cv2
import numpy as np

from tacshade_edge.sensor.contact.parting import part_objects
from tacshade_edge.sensor.depth.solver import Depth
from tacshade_edge.sensor.geometry.disc import (
    DiscRays,
    cell_area_mm2,
    least_area_mm2,
    skin_planes,
)
from tacshade_edge.sensor.profiles import KMEANS, NETWORK, Outline
from tacshade_edge.types import (
    F32,
    F64,
    I64,
    U16,
    Bool,
    Geometry,
    ObjectCloud,
    TouchedObject,
    frozen,
)

TWIST_CELLS = 6  # least number of cells for a twist
BINS = 256
MIN_OBJECT_MM2 = 0.5  # smaller patches are no objects (`least_area_mm2`)
LABELS_MAX = np.iinfo(np.uint16).max

Box = tuple[slice, slice]


Spread = Sequence[Sequence[float]]


def spreads(values: F64, ends: Sequence[int]) -> tuple[list[list[float]], list[Spread]]:
    """The mean of each object's values (dimensions, N), which end at `ends`, and the sums of the
    products of any two dimensions less their means; no object is empty.
    """
    first = values[:, :1].copy()  # near all others, so that nothing cancels
    rows = np.empty((len(values) + 1, values.shape[1]))
    np.subtract(values, first, out=rows[:-1])
    rows[-1] = 1
    origin, means = first[:, 0].tolist(), []
    made: list[Spread] = []
    for start, end in pairwise((0, *ends)):
        part = rows[:, start:end]
        # The last row is of ones: one product of matrices gives all sums, products and the count.
        *products, (*totals, count) = (part @ part.T).tolist()
        mean = [total / count for total in totals]
        means.append(list(map(add, origin, mean)))
        made.append(
            [
                [p - m * t for p, t in zip(row, totals, strict=False)]
                for row, m in zip(products, mean, strict=True)
            ]
        )
    return means, made


def normals(spread: Sequence[Spread]) -> list[list[float]]:
    """Unit normals of planes through points, from their spreads, which begin with x, y, z;
    away from the camera.
    """
    # `eigh` sorts its values upwards: the first vector is the direction of least spread.
    least = np.linalg.eigh(np.array([[row[:3] for row in each[:3]] for each in spread]))[1][:, :, 0]
    normal: list[list[float]] = (least * np.where(least[:, 2:] < 0, -1.0, 1.0)).tolist()
    return normal


def rigid_motion(spread: Spread, count: int) -> tuple[float | None, float]:
    """Angle in degrees about z, from x towards y, of the least-squares rotation of a contact about
    its mean (None below `TWIST_CELLS`); RMS in mm of its motion beyond that and the mean shear.
    Takes the spread of x, y, z and shear x, y.
    """
    (xx, _, _, x_sx, x_sy), (_, yy, _, y_sx, y_sy), _, (*_, sx_sx, _), (*_, sy_sy) = spread
    # Umeyama 1991, in the plane, of places before (less shear) and now:
    # proportional to cosine and sine of the angle.
    along, across = xx + yy - x_sx - y_sy, x_sy - y_sx
    rest = 2 * along + sx_sx + sy_sy - 2 * math.hypot(along, across)
    twist = math.degrees(math.atan2(across, along)) if count >= TWIST_CELLS else None
    return twist, math.sqrt(max(rest, 0.0) / count)


@frozen
class Objects:
    """All objects in contact: their cells, points ordered by label, description (the largest first,
    at least one), volume displaced.
    """

    contact: Bool
    cloud: ObjectCloud
    described: tuple[TouchedObject, ...]
    volume_mm3: float


def contact_of(depth: Depth, inside: Bool, outline: Outline = NETWORK) -> Bool:
    """Cells where the skin touches an object, bool (rows, cols), without untrusted cells: the
    network's contact, or the paper's split of the heights as found (clipped ones would all be equal
    for a great α), which also serves a solver without a network. `inside` is the disc.
    """
    if depth.contact is None or outline == KMEANS:
        contact = inside & (depth.height_mm > two_means_split(depth.height_mm[inside]))
    else:
        contact = depth.contact
    return contact if depth.untrusted is None else contact & ~depth.untrusted


def find_objects(
    contact: Bool,
    height_mm: F32,
    shear_mm: F32 | None,
    rays: DiscRays,
    geometry: Geometry,
    contact_logit: F32 | None = None,
) -> Objects | None:
    """Separate the objects in contact, with points of their skin; None if nothing touches.

    `contact`, bool (rows, cols), holds only cells with a height; `height_mm`, float32 (rows, cols),
    is h, at most r, NaN outside the disc; `shear_mm` is float32 (rows, cols, 2); `contact_logit`,
    float32 (rows, cols), the network's, if there is one. `rays` are those of the same grid.
    """
    box = bounding_box(contact)
    if box is None:
        return None
    # Every box that holds the contact and a cell around it gives the same points and areas, and a
    # contact seldom fills the disc.
    height = np.ascontiguousarray(height_mm[box])
    planes = skin_planes(height, rays.part(box), geometry)
    area = cell_area_mm2(planes)
    logit = None if contact_logit is None else contact_logit[box]
    least_mm2 = least_area_mm2(MIN_OBJECT_MM2, geometry)
    labels = label_objects(contact[box], area, planes, logit, least_mm2)
    return _objects(labels, box, height_mm, shear_mm, planes, area)


def objects_of(
    labels: U16, height_mm: F32, shear_mm: F32 | None, rays: DiscRays, geometry: Geometry
) -> Objects | None:
    """The objects that another program found: `labels` (rows, cols) are the numbers of their cells,
    which have a height, and 0 elsewhere; missing numbers are closed up.
    """
    box = bounding_box(labels > 0)
    if box is None:
        return None
    planes = skin_planes(np.ascontiguousarray(height_mm[box]), rays.part(box), geometry)
    numbers = np.unique(np.append(labels[box], 0), return_inverse=True)[1][:-1]
    closed = numbers.reshape(labels[box].shape).astype(np.uint16)
    return _objects(closed, box, height_mm, shear_mm, planes, cell_area_mm2(planes))


def _objects(
    labels: U16, box: Box, height_mm: F32, shear_mm: F32 | None, planes: F32, area: F32
) -> Objects | None:
    # Not the contact asked for: cells of patches that are no objects are left out.
    labelled = np.zeros(height_mm.shape, bool)
    labelled[box] = labels > 0
    cells = cells_by_label(labels)
    if cells.size == 0:
        return None
    x_y_z = planes.reshape(3, -1).take(cells, axis=1)
    # Several times as fast as NumPy's copy of a turned view.
    points = np.asarray(cv2.transpose(x_y_z), np.float32)
    cloud = ObjectCloud(points, labels.take(cells))
    heights, areas = height_mm[box].take(cells), area.take(cells)
    volume_mm3 = float((heights * areas).sum(dtype=np.float64))
    moved = None if shear_mm is None else shear_mm[box].reshape(-1, 2).take(cells, axis=0).T
    return Objects(
        labelled, cloud, _described(x_y_z, cloud.labels, heights, areas, moved), volume_mm3
    )


def bounding_box(contact: Bool) -> Box | None:
    """Rows and columns of the contact plus one on each side,
    because a cell's area needs its neighbours.
    """
    # NumPy's bool is a byte of 0 or 1, and OpenCV takes such bytes: a view, where `astype` would
    # copy.
    left, top, width, height = cv2.boundingRect(contact.view(np.uint8))
    if width == 0:
        return None
    return slice(max(top - 1, 0), top + height + 1), slice(max(left - 1, 0), left + width + 1)


def two_means_split(values: F32) -> float:
    """The threshold of k-means with k = 2 over finite values, float32 (N,), the paper's separation
    of object and skin (section V-A): values above it are the upper cluster; infinity without two
    different values. It maximises the variance between the clusters
    (Otsu), over every threshold of a histogram.
    """
    if values.size == 0:
        return float("inf")
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return float("inf")
    # Of one dimension, a cluster is an interval: trying every threshold finds the global optimum
    # (up to a bin), which Lloyd's iterations only approach, and needs no seed.
    counts, edges = np.histogram(values.astype(np.float64), bins=BINS, range=(low, high))
    middles = (edges[:-1] + edges[1:]) / 2
    n0 = np.cumsum(counts)[:-1]
    n1 = values.size - n0
    sum0 = np.cumsum(counts * middles)[:-1]
    sum1 = float((counts * middles).sum()) - sum0
    with np.errstate(invalid="ignore", divide="ignore"):
        between = np.nan_to_num(n0 * n1 * (sum0 / n0 - sum1 / n1) ** 2, nan=-1.0)
    # All thresholds in the empty bins between two clusters give the same split:
    # k-means' boundary is their middle.
    best = np.flatnonzero(n0 == n0[np.argmax(between)])
    middle = float((edges[best[0] + 1] + edges[best[-1] + 1]) / 2)
    # Round down to float32, so that adjacent float32 values are still separated.
    split = np.float32(middle)
    return float(split if float(split) <= middle else np.nextafter(split, np.float32(-np.inf)))


def label_objects(
    contact: Bool,
    cell_area: F32,
    planes_mm: F32,
    contact_logit: F32 | None = None,
    least_mm2: float = MIN_OBJECT_MM2,
) -> U16:
    """Number the objects, which are connected contacts (8-neighbours) or parts of them, from 1, the
    largest area first: uint16 (rows, cols), from cells of `cell_area` mm²; 0 outside, in patches
    below `least_mm2`, and beyond the 65535 objects that a cloud can number.
    """
    count, raw = cv2.connectedComponents(contact.view(np.uint8), connectivity=8)
    count = part_objects(raw, count, planes_mm, cell_area, contact_logit)
    areas = np.bincount(np.ravel(raw), weights=cell_area.ravel(), minlength=count)
    areas[0] = 0.0
    # Stable, so that equal areas keep the order of the scan on every processor.
    order = (-areas).argsort(kind="stable")
    order = order[: min(np.count_nonzero(areas >= least_mm2), LABELS_MAX)]
    new_label = np.zeros(count, dtype=np.uint16)
    new_label[order] = np.arange(1, len(order) + 1)
    labels: U16 = new_label.take(raw)
    return labels


def cells_by_label(labels: U16) -> I64:
    """Flat indices of the labelled cells: object by object, row by row in each."""
    cells = np.flatnonzero(labels)
    if labels.max(initial=0) <= 1:
        return cells
    # For 16 bits, a stable sort is a radix sort.
    return np.asarray(cells.take(labels.take(cells).argsort(kind="stable")), np.int64)


def _described(
    x_y_z: F32, labels: U16, height_mm: F32, cell_area: F32, shear_mm: F32 | None
) -> tuple[TouchedObject, ...]:
    """The labelled contacts, from points (3, N), their labels in order and without gaps, and
    height, area of skin and shear (2, N) there.
    """
    ends = np.bincount(labels).cumsum()
    # `ends` of label 0 is 0, and so the start of label 1. `reduceat` gives an empty range its next
    # value instead of none, so no label may be missing.
    starts = ends[:-1]
    means, spread = spreads(
        np.concatenate((x_y_z, *([] if shear_mm is None else [shear_mm])), dtype=np.float64),
        ends[1:].tolist(),
    )
    highest, lowest = (
        extreme.reduceat(x_y_z, starts, axis=1) for extreme in (np.maximum, np.minimum)
    )
    columns: tuple[list[Any], ...] = (
        list(map(tuple, (highest.astype(np.float64) - lowest).T.tolist())),
        np.maximum.reduceat(height_mm, starts).tolist(),
        np.add.reduceat(cell_area, starts, dtype=np.float64).tolist(),
        list(map(tuple, normals(spread))),
    )
    made = []
    for label, (extent, depth, area, normal) in enumerate(zip(*columns, strict=True)):
        x, y, z, *shear = means[label]
        moved: tuple[Any, ...] = (
            (tuple(shear), *rigid_motion(spread[label], int(ends[label + 1] - ends[label])))
            if shear
            else ()
        )
        made.append(TouchedObject(label + 1, (x, y, z), extent, depth, area, normal, *moved))
    return tuple(made)
