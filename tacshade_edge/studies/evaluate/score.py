"""Score a reconstruction against its ground truth: eqs. 13 and 14 of the paper, the outline, the depth."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from tacshade_edge.reasons import text_of
from tacshade_edge.simulator.truth import Truth
from tacshade_edge.types import F32, Bool, HeightMap, Reconstruction, frozen

NOTHING = np.zeros((0, 3), dtype=np.float32)
"""The points of an untouched skin."""


@dataclass(frozen=True, slots=True)
class CloudScore:
    """The agreement of a reconstructed cloud with the true one; for an empty cloud, SD is 0 and distances are NaN."""

    me_mm: float  # eq. 13, the mean distance from reconstructed points to the nearest true point
    sd: float  # eq. 14 with half the sum of both mean distances (unsquared), not clamped at 0
    sd_sum: float  # eq. 14 with the whole sum
    backward_mm: float  # the mean distance from true points to the nearest reconstructed point


def score_cloud(points_mm: F32, true_points_mm: F32, h_max_mm: float) -> CloudScore:
    """Compute ME and SD of a cloud (N, 3), given the true points (M, 3; M > 0) and the true maximum of h."""
    from scipy.spatial import cKDTree  # scoring is not on the daemon's path

    if not len(points_mm):
        return CloudScore(math.nan, 0.0, 0.0, math.nan)
    forward = float(cKDTree(true_points_mm).query(points_mm)[0].mean())
    backward = float(cKDTree(points_mm).query(true_points_mm)[0].mean())
    return CloudScore(forward, 1 - (forward + backward) / 2 / h_max_mm, 1 - (forward + backward) / h_max_mm, backward)


def contact_iou(found: Bool, true: Bool) -> float:
    """Intersection over union of two contact maps; 1 when both are empty."""
    union = np.count_nonzero(found | true)
    return 1.0 if union == 0 else np.count_nonzero(found & true) / union


@frozen
class KnownTruth:
    """The ground truth of a frame: skin points in contact, the greatest h over the disc, and the contact if known.

    Cell (i, j) of `contact` is pixel (row0 + i·step_px, col0 + j·step_px).
    """

    points_mm: F32  # (N, 3) in the sensor frame; N = 0 if nothing touches
    depth_max_mm: float
    contact: Bool | None
    row0: float = 0.0
    col0: float = 0.0
    step_px: float = 1.0

    @classmethod
    def of(cls, true: Truth) -> KnownTruth:
        """The ground truth of a simulated frame."""
        return cls(between_pixels(true.points_mm, true.contact), true.depth_max_mm, true.contact)

    def contact_on(self, height: HeightMap) -> Bool | None:
        """Sample `contact` at the cells of a height map (the nearest cell; False beyond its edge)."""
        if self.contact is None:
            return None
        rows, cols = self.contact.shape
        i, j = (
            np.rint((origin + height.step_px * np.arange(count) - mine) / self.step_px).astype(int)
            for origin, count, mine in zip(
                (height.row0, height.col0), height.contact.shape, (self.row0, self.col0), strict=True
            )
        )
        known = ((i >= 0) & (i < rows))[:, None] & ((j >= 0) & (j < cols))[None, :]
        taken: Bool = known & self.contact[np.clip(i, 0, rows - 1)[:, None], np.clip(j, 0, cols - 1)[None, :]]
        return taken


def between_pixels(points_mm: F32, contact: Bool) -> F32:
    """Add the midpoints between neighbouring pixels' points, which are in the order of the pixels of `contact`.

    Without them, a found point between pixels would have an error of up to half a pixel. Across a steep step, over
    three times the usual distance, no midpoint is added. The given points come first.
    """
    at = np.full((*contact.shape, 3), np.nan, np.float32)
    at[contact] = points_mm
    pairs = [(at[:, :-1], at[:, 1:]), (at[:-1], at[1:]), (at[:-1, :-1], at[1:, 1:]), (at[1:, :-1], at[:-1, 1:])]
    apart = [np.linalg.norm(one - other, axis=-1) for one, other in pairs]
    beside = apart[0][np.isfinite(apart[0])]
    if not beside.size:
        return points_mm
    near = 3 * np.median(beside)
    middles = [((one + other) / 2)[far < near] for (one, other), far in zip(pairs, apart, strict=True)]
    return np.concatenate((points_mm, *middles)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Label:
    """The columns of a row that identify its frame; `object` is ``none`` for a frame without contact."""

    sensor: str
    object: str
    image: str = ""  # the user's image; for a simulated frame without contact, the change made to it
    depth_mm: float = math.nan  # the stated press
    x_mm: float = math.nan
    y_mm: float = math.nan
    rotation_deg: float = math.nan


@dataclass(frozen=True, slots=True)
class Row:
    """The scores of one profile on one frame; each attribute is a column of evaluation.csv, empty if NaN.

    Without true contact, errors are NaN; for a missed contact, ME and the backward distance are.
    """

    profile: str
    sensor: str
    object: str
    image: str
    depth_mm: float
    x_mm: float
    y_mm: float
    rotation_deg: float
    valid: bool
    contact: bool
    saturated: bool
    true_depth_mm: float
    found_depth_mm: float
    depth_error_pct: float
    me_mm: float
    sd_pct: float
    sd_sum_pct: float
    backward_mm: float
    iou: float
    points: int
    true_points: int
    objects: int
    repaired_px: int
    degraded: str  # why the reconstruction is invalid or degraded


def score(label: Label, truth: KnownTruth, result: Reconstruction) -> Row:
    """Compare a reconstruction with its frame's ground truth."""
    touched, nan = len(truth.points_mm) > 0, math.nan
    cloud = score_cloud(result.cloud.points_mm, truth.points_mm, truth.depth_max_mm) if touched else None
    contact = truth.contact_on(result.height)
    return Row(
        profile=result.profile,
        **asdict(label),
        valid=result.valid,
        contact=result.contact,
        saturated=result.saturated,
        true_depth_mm=truth.depth_max_mm,
        found_depth_mm=result.depth_max_mm,
        depth_error_pct=100 * (result.depth_max_mm / truth.depth_max_mm - 1) if touched else nan,
        me_mm=cloud.me_mm if cloud else nan,
        sd_pct=100 * cloud.sd if cloud else nan,
        sd_sum_pct=100 * cloud.sd_sum if cloud else nan,
        backward_mm=cloud.backward_mm if cloud else nan,
        iou=contact_iou(result.height.contact, contact) if touched and contact is not None else nan,
        points=len(result.cloud.points_mm),
        true_points=len(truth.points_mm),
        objects=len(result.objects),
        repaired_px=result.repaired_px,
        degraded=text_of(result.reason or result.degraded),
    )
