"""Eqs. 13 and 14 of the paper, and the overlap of contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F32, Bool


@dataclass(frozen=True, slots=True)
class CloudScore:
    """The agreement of a reconstructed cloud with the true one.

    Attributes
    ----------
    me_mm : float
        Eq. 13, the mean distance from reconstructed points to the nearest true point; NaN for an empty cloud, which is
        a failure.
    sd : float
        Eq. 14 with d_CD as half the sum of the two mean distances (unsquared); not clamped at 0; 0 for an empty cloud.
    sd_sum : float
        Eq. 14 with d_CD as the whole sum.
    forward_mm, backward_mm : float
        Mean distances from reconstructed to true points, and from true to reconstructed ones.
    points, true_points : int
    """

    me_mm: float
    sd: float
    sd_sum: float
    forward_mm: float
    backward_mm: float
    points: int
    true_points: int


def score_cloud(points_mm: F32, true_points_mm: F32, h_max_mm: float) -> CloudScore:
    """Compute ME and SD of a cloud.

    Parameters
    ----------
    points_mm, true_points_mm : float32 (N, 3), (M, 3)
        Reconstructed and true contact points; M at least 1.
    h_max_mm : float
        True maximum of h over the disc, above 0.
    """
    from scipy.spatial import cKDTree  # scoring is not on the daemon's path

    n, m = len(points_mm), len(true_points_mm)
    if n == 0:
        return CloudScore(float("nan"), 0.0, 0.0, float("nan"), float("nan"), n, m)
    forward = float(cKDTree(true_points_mm).query(points_mm)[0].mean())
    backward = float(cKDTree(points_mm).query(true_points_mm)[0].mean())
    return CloudScore(
        me_mm=forward,
        sd=1 - (forward + backward) / 2 / h_max_mm,
        sd_sum=1 - (forward + backward) / h_max_mm,
        forward_mm=forward,
        backward_mm=backward,
        points=n,
        true_points=m,
    )


def contact_iou(found: Bool, true: Bool) -> float:
    """Intersection over union of two contact maps; 1 when both are empty."""
    union = np.count_nonzero(found | true)
    return 1.0 if union == 0 else np.count_nonzero(found & true) / union
