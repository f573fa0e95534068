"""Object clouds: the paper's two-means split of heights, then one label for every connected contact."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.types import F32, I32, Bool, ObjectCloud, TouchedObject

BINS = 256
# Smaller patches are not an object a finger could tell.
MIN_OBJECT_MM2 = 0.5


def two_means_split(values: F32) -> float:
    """Threshold of the k-means with k = 2 over scalar values, the paper's separation of object and skin.

    In one dimension each cluster is an interval, so k-means is the choice of one threshold, and minimising
    the variance within the two intervals is maximising the variance between them, which is Otsu's criterion.
    Trying every threshold of a histogram therefore gives the global optimum (up to a bin) that Lloyd's
    iterations only approach, without a seed.

    Parameters
    ----------
    values : float32 (N,)
        Finite.

    Returns
    -------
    float
        Values above it are the upper cluster; infinity where there are not two different values.
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
    # Every threshold over the empty bins between two clusters is the same split: their middle is k-means' boundary.
    best = np.flatnonzero(n0 == n0[np.argmax(between)])
    return float((edges[best[0] + 1] + edges[best[-1] + 1]) / 2)


def label_objects(contact: Bool, cell_area: F32) -> I32:
    """Number the connected contacts (8-neighbours), the greatest area first; patches under 0.5 mm² vanish.

    Parameters
    ----------
    contact : bool (rows, cols)
    cell_area : float32 (rows, cols)
        mm² of skin per cell.

    Returns
    -------
    int32 (rows, cols)
        0 outside every object, else its number from 1.
    """
    count, raw = cv2.connectedComponents(contact.astype(np.uint8), connectivity=8)
    raw = np.asarray(raw, dtype=np.int32)
    areas = np.bincount(raw.ravel(), weights=np.nan_to_num(cell_area).ravel().astype(np.float64), minlength=count)
    areas[0] = 0.0
    order = [int(i) for i in np.argsort(-areas, kind="stable") if areas[i] >= MIN_OBJECT_MM2]
    new_label = np.zeros(count, dtype=np.int32)
    new_label[order] = np.arange(1, len(order) + 1)
    labels: I32 = new_label[raw]
    return labels


def describe_objects(labels: I32, points_mm: F32, height_mm: F32, cell_area: F32) -> tuple[TouchedObject, ...]:
    """Centroid, extent, depth and area of every labelled contact."""
    objects = []
    for label in range(1, int(labels.max(initial=0)) + 1):
        cells = labels == label
        points = points_mm[cells].astype(np.float64)
        middle, extent = points.mean(axis=0), points.max(axis=0) - points.min(axis=0)
        objects.append(
            TouchedObject(
                label=label,
                centroid_mm=(float(middle[0]), float(middle[1]), float(middle[2])),
                extent_mm=(float(extent[0]), float(extent[1]), float(extent[2])),
                depth_max_mm=float(height_mm[cells].max()),
                area_mm2=float(np.nansum(cell_area[cells])),
            )
        )
    return tuple(objects)


def object_cloud(labels: I32, points_mm: F32) -> ObjectCloud:
    """The labelled skin points as one cloud, ordered by label."""
    cells = np.flatnonzero(labels.ravel())
    cells = cells[np.argsort(labels.ravel()[cells], kind="stable")]
    return ObjectCloud(
        points_mm=points_mm.reshape(-1, 3)[cells].astype(np.float32), labels=labels.ravel()[cells].astype(np.uint16)
    )
