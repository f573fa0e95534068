"""Explain which motions are missing if presses do not show the sensor's place on the flange."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.core.stitching.flange import ORDER, FoundFlange
from tacshade_edge.core.stitching.flange_equations import ContactFrame
from tacshade_edge.rigid import Rigid, of_pose
from tacshade_edge.types import F64

SEEN_MM, SEEN_DEG, SEEN_MS = 2.0, 2.5, 10.0
"""Standard deviation above which a direction was not seen."""
_SPREAD_DEG = 3.0


def unseen(frames: Sequence[ContactFrame], start: Rigid, found: FoundFlange) -> str:
    """What cannot be determined, why, and what was expected, as one line; empty if the place on the flange is known.
    The directions are the eigenvectors of the covariance of translation and of rotation, named after the nearest axis
    of the flange.
    """
    blocks = (("translation along", slice(0, 3), SEEN_MM), ("rotation about", slice(3, 6), SEEN_DEG))
    names = []
    for name, block, most in blocks:
        variance, vectors = np.linalg.eigh(found.covariance[block, block])
        axes = sorted({"xyz"[int(k)] for k in np.abs(vectors[:, variance > most**2]).argmax(axis=0)})
        if axes:
            names.append(f"{name} {' and '.join(filter(None, (', '.join(axes[:-1]), axes[-1])))}")
    if not names:
        return ""
    return f"{', '.join(names)} cannot be determined: {_why(frames, start)}"


def delay_seen(found: FoundFlange) -> bool:
    """Whether presses show the delay, which needs motion in contact."""
    k = ORDER.index("delay_ms")
    return bool(found.covariance[k, k] < SEEN_MS**2)


def _why(frames: Sequence[ContactFrame], start: Rigid) -> str:
    turned = [of_pose(frame.track[0]).rotation @ start.rotation for frame in frames]
    yaw_deg, tilt_deg = (
        _spread_deg(np.stack([r[:, 0] for r in turned])),
        _spread_deg(np.stack([r[:, 2] for r in turned])),
    )
    if max(yaw_deg[0], tilt_deg[0]) < _SPREAD_DEG:
        return "every press has the same orientation, expected presses that differ by a yaw of ±90° and a tilt of ±15°"
    if tilt_deg[1] < _SPREAD_DEG:
        about = "no press is tilted" if tilt_deg[0] < _SPREAD_DEG else "all tilts are about one axis"
        return f"{about}, expected tilts of ±15° about two axes"
    return "the presses hardly overlap, or the surface is flat; expected overlapping presses on a wavy surface"


def _spread_deg(directions: F64) -> tuple[float, float]:
    """Standard deviations of unit vectors (N, 3) about their mean in degrees, the larger one first."""
    values = np.linalg.svd(directions - directions.mean(axis=0), compute_uv=False) / np.sqrt(len(directions))
    return float(np.degrees(values[0])), float(np.degrees(values[1])) if len(values) > 1 else 0.0
