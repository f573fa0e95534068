"""Score a reconstruction against its ground truth: eqs. 13 and 14, the outline, the depth."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from tacshade_edge.reasons import text_of
from tacshade_edge.simulator.truth import Truth
from tacshade_edge.studies.metrics import contact_iou, score_cloud
from tacshade_edge.types import F32, Bool, HeightMap, Reconstruction, freeze

NOTHING = np.zeros((0, 3), dtype=np.float32)
"""The points of an untouched skin."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownTruth:
    """The ground truth of a frame.

    Attributes
    ----------
    points_mm : float32 (N, 3)
        Skin points in contact, in the sensor frame; N = 0 if nothing touches.
    depth_max_mm : float
        Greatest true h over the disc.
    contact : bool (rows, cols) or None
        Cells in contact, on a grid of the image; None if unknown.
    row0, col0, step_px : float
        Cell (i, j) of `contact` is pixel (row0 + i·step_px, col0 + j·step_px).
    """

    points_mm: F32
    depth_max_mm: float
    contact: Bool | None
    row0: float = 0.0
    col0: float = 0.0
    step_px: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, "points_mm", *(("contact",) if self.contact is not None else ()))

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
    """Add the midpoints between neighbouring pixels' points.

    Without them, a found point between pixels would have an error of up to half a pixel. Across a steep step, over
    three times the usual distance, no midpoint is added.

    Parameters
    ----------
    points_mm : float32 (N, 3)
        Points of the pixels of `contact`, in their order.
    contact : bool (H, W)

    Returns
    -------
    float32 (M, 3)
        The given points first.
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
class Row:
    """The scores of one profile on one frame; each attribute is a column of evaluation.csv, empty if NaN.

    Attributes
    ----------
    profile, sensor, object : str
        `object` is ``none`` for a frame without contact.
    image : str
        The user's image; for a simulated frame without contact, the change made to it.
    depth_mm, x_mm, y_mm, rotation_deg : float
        The stated press; NaN if there is none.
    valid, contact, saturated : bool
        As reconstructed.
    true_depth_mm, found_depth_mm, depth_error_pct : float
        Greatest h, and its relative error (NaN without true contact).
    me_mm, sd_pct, sd_sum_pct, backward_mm : float
        Eqs. 13 and 14 (`studies.metrics.CloudScore`); ME is the forward distance. NaN without true contact; ME and
        backward distance are also NaN for a missed contact.
    iou : float
    points, true_points, objects, repaired_px : int
    degraded : str
        Why the reconstruction is invalid or degraded.
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
    degraded: str


@dataclass(frozen=True, slots=True)
class Label:
    """The columns of a row that identify its frame."""

    sensor: str
    object: str
    image: str = ""
    depth_mm: float = math.nan
    x_mm: float = math.nan
    y_mm: float = math.nan
    rotation_deg: float = math.nan


def score(label: Label, truth: KnownTruth, result: Reconstruction) -> Row:
    """Compare a reconstruction with its frame's ground truth."""
    touched = len(truth.points_mm) > 0
    cloud = score_cloud(result.cloud.points_mm, truth.points_mm, truth.depth_max_mm) if touched else None
    contact = truth.contact_on(result.height)
    nan = math.nan
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
