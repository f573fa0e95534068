"""Make object clouds: the contact, one label for every connected part, and a plane and a planar motion for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from tacshade_edge.core.depth.base import Depth
from tacshade_edge.core.geometry.disc import DiscRays, cell_area_mm2, skin_planes
from tacshade_edge.types import F32, F64, I64, U16, Bool, Geometry, ObjectCloud, TouchedObject, frozen

TWIST_CELLS = 6  # least number of cells for a twist
BINS = 256
MIN_OBJECT_MM2 = 0.5  # smaller patches are no objects
LABELS_MAX = np.iinfo(np.uint16).max

Box = tuple[slice, slice]


def about_mean(values: F32, starts: I64, counts: I64) -> tuple[F64, F64]:
    """The mean of each object's values (dimensions, N), and the values less the mean; float64."""
    means: F64 = np.add.reduceat(values, starts, axis=1, dtype=np.float64) / counts
    return means, np.subtract(values, np.repeat(means, counts, axis=1), dtype=np.float64)


def normals(about_mean_mm: F64, starts: I64) -> F64:
    """Unit normals (objects, 3) of the planes through each object's points (3, N) less their mean, away from the
    camera; no object is empty.
    """
    covariance = np.stack([points @ points.T for points in np.split(about_mean_mm, starts[1:], axis=1)])
    least: F64 = np.linalg.eigh(covariance)[1][:, :, 0]
    return least * np.where(least[:, 2:] < 0, -1.0, 1.0)


def rigid_motions(
    about_mean_mm: F64, shear_mm: F32, starts: I64, counts: I64
) -> tuple[list[tuple[float, float]], list[float | None], list[float]]:
    """Mean shear of each object's contact; angle in degrees about z, from x towards y, of the least-squares rotation
    about the mean (None below `TWIST_CELLS`); RMS in mm of the motion beyond both. Takes x and y (2, N) less their
    mean, and shear.
    """
    now = about_mean_mm
    shear, moved = about_mean(shear_mm, starts, counts)
    before = now - moved
    # Umeyama 1991, in the plane: the first two are proportional to the cosine and sine of the angle.
    along, across, squares = (
        np.add.reduceat(values, starts)
        for values in (
            before[0] * now[0] + before[1] * now[1],
            before[0] * now[1] - before[1] * now[0],
            np.sum(before**2 + now**2, axis=0),
        )
    )
    strain = np.sqrt(np.maximum(squares - 2 * np.hypot(along, across), 0) / counts)
    twist = np.degrees(np.arctan2(across, along)).tolist()
    known = [angle if count >= TWIST_CELLS else None for angle, count in zip(twist, counts.tolist(), strict=True)]
    return [(x, y) for x, y in shear.T.tolist()], known, strain.tolist()


@frozen
class Objects:
    """All objects in contact: their cells, points ordered by label, description (the largest first, at least one),
    volume displaced.
    """

    contact: Bool
    cloud: ObjectCloud
    described: tuple[TouchedObject, ...]
    volume_mm3: float


def contact_of(depth: Depth, inside: Bool) -> Bool:
    """Cells where the skin touches an object: the solver's contact, else the paper's split of the heights as found
    (clipped ones would all be equal for a great α), without untrusted cells.
    """
    if depth.contact is None:
        contact = inside & (depth.height_mm > two_means_split(depth.height_mm[inside]))
    else:
        contact = depth.contact
    return contact if depth.untrusted is None else contact & ~depth.untrusted


def find_objects(
    contact: Bool, height_mm: F32, shear_mm: F32 | None, rays: DiscRays, geometry: Geometry
) -> Objects | None:
    """Separate the objects in contact, with points of their skin; None if nothing touches. `contact` holds only cells
    with a height; shear is (rows, cols, 2).
    """
    box = bounding_box(contact)
    if box is None:
        return None
    height = np.ascontiguousarray(height_mm[box])
    planes = skin_planes(height, rays.part(box), geometry)
    area = cell_area_mm2(planes)
    labels = label_objects(contact[box], area)
    labelled = np.zeros(contact.shape, bool)
    labelled[box] = labels > 0
    cells = cells_by_label(labels)
    if cells.size == 0:
        return None
    x_y_z = planes.reshape(3, -1).take(cells, axis=1)
    cloud = ObjectCloud(np.ascontiguousarray(x_y_z.T), labels.take(cells))
    heights, areas = height.take(cells), area.take(cells)
    volume_mm3 = float((heights * areas).sum(dtype=np.float64))
    moved = None if shear_mm is None else shear_mm[box].reshape(-1, 2).take(cells, axis=0).T
    return Objects(labelled, cloud, _described(x_y_z, cloud.labels, heights, areas, moved), volume_mm3)


def bounding_box(contact: Bool) -> Box | None:
    """Rows and columns of the contact plus one on each side, because a cell's area needs its neighbours."""
    left, top, width, height = cv2.boundingRect(contact.view(np.uint8))
    if width == 0:
        return None
    return slice(max(top - 1, 0), top + height + 1), slice(max(left - 1, 0), left + width + 1)


def two_means_split(values: F32) -> float:
    """The threshold of k-means with k = 2 over finite values, the paper's separation of object and skin; infinity
    without two different values. It maximises the variance between the clusters (Otsu), over every threshold of a
    histogram.
    """
    if values.size == 0:
        return float("inf")
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return float("inf")
    counts, edges = np.histogram(values.astype(np.float64), bins=BINS, range=(low, high))
    middles = (edges[:-1] + edges[1:]) / 2
    n0 = np.cumsum(counts)[:-1]
    n1 = values.size - n0
    sum0 = np.cumsum(counts * middles)[:-1]
    sum1 = float((counts * middles).sum()) - sum0
    with np.errstate(invalid="ignore", divide="ignore"):
        between = np.nan_to_num(n0 * n1 * (sum0 / n0 - sum1 / n1) ** 2, nan=-1.0)
    # All thresholds in the empty bins between two clusters give the same split: k-means' boundary is their middle.
    best = np.flatnonzero(n0 == n0[np.argmax(between)])
    middle = float((edges[best[0] + 1] + edges[best[-1] + 1]) / 2)
    # Round down to float32, so that adjacent float32 values are still separated.
    split = np.float32(middle)
    return float(split if float(split) <= middle else np.nextafter(split, np.float32(-np.inf)))


def label_objects(contact: Bool, cell_area: F32) -> U16:
    """Number the connected contacts (8-neighbours) from 1, the largest area first; 0 outside, in patches below 0.5 mm²,
    and beyond the 65535 objects that a cloud can number.
    """
    count, raw = cv2.connectedComponents(contact.view(np.uint8), connectivity=8)
    areas = np.bincount(np.ravel(raw), weights=cell_area.ravel(), minlength=count)
    areas[0] = 0.0
    order = (-areas).argsort(kind="stable")
    order = order[: min(np.count_nonzero(areas >= MIN_OBJECT_MM2), LABELS_MAX)]
    new_label = np.zeros(count, dtype=np.uint16)
    new_label[order] = np.arange(1, len(order) + 1)
    labels: U16 = new_label.take(raw)
    return labels


def cells_by_label(labels: U16) -> I64:
    """Flat indices of the labelled cells: object by object, row by row in each."""
    cells = np.flatnonzero(labels)
    # For 16 bits, a stable sort is a radix sort.
    return np.asarray(cells.take(labels.take(cells).argsort(kind="stable")), np.int64)


def _described(
    x_y_z: F32, labels: U16, height_mm: F32, cell_area: F32, shear_mm: F32 | None
) -> tuple[TouchedObject, ...]:
    """The labelled contacts, from points (3, N), their labels in order and without gaps, and height, area of skin and
    shear (2, N) there.
    """
    numbers = np.arange(1, labels[-1] + 1, dtype=np.uint16)
    ends = labels.searchsorted(numbers, side="right")
    starts = np.zeros_like(ends)
    starts[1:] = ends[:-1]
    counts = ends - starts
    middles, points = about_mean(x_y_z, starts, counts)
    highest, lowest = (extreme.reduceat(x_y_z, starts, axis=1) for extreme in (np.maximum, np.minimum))
    extents = highest.astype(np.float64) - lowest
    depths = np.maximum.reduceat(height_mm, starts)
    areas = np.add.reduceat(cell_area, starts, dtype=np.float64)
    parts: list[Sequence[Any]] = [
        *(list(zip(*values.tolist(), strict=True)) for values in (middles, extents)),
        *(values.tolist() for values in (depths, areas)),
        list(zip(*normals(points, starts).T.tolist(), strict=True)),
    ]
    if shear_mm is not None:
        parts += rigid_motions(points[:2], shear_mm, starts, counts)
    return tuple(TouchedObject(label, *values) for label, values in enumerate(zip(*parts, strict=True), start=1))
