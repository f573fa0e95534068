"""Judge how far to trust a preprocessed frame, by glare and a change of light or focus."""

from __future__ import annotations

from tacshade_edge.reasons import Reason, ReasonCode

# A common change of g above the first degrades a frame; above the second the frame is another image.
DRIFT_LEVELS, DRIFT_INVALID_LEVELS = 12.0, 30.0
# With more of the disc under glare than this, the rest shows too little.
UNSEEN_INVALID = 0.4


def invalid_reason(unseen: float, drift_grey: float) -> Reason | None:
    """Why a frame cannot be used; None if it can.

    Parameters
    ----------
    unseen : float
        Part of the disc under glare, 0 to 1.
    drift_grey : float
        Common change of g since the reference, grey levels.
    """
    if unseen > UNSEEN_INVALID:
        return _glare(unseen)
    return _light_drift(drift_grey) if abs(drift_grey) > DRIFT_INVALID_LEVELS else None


def degraded_reason(unseen: float, drift_grey: float) -> Reason | None:
    """Why a valid frame is degraded; None if it is not. The parameters are those of `invalid_reason`."""
    if abs(drift_grey) > DRIFT_LEVELS:
        return _light_drift(drift_grey)
    return _glare(unseen) if unseen > 0 else None


def _glare(unseen: float) -> Reason:
    return Reason(ReasonCode.GLARE, f"glare hides {100 * unseen:.0f} % of the disc")


def _light_drift(drift_grey: float) -> Reason:
    return Reason(
        ReasonCode.LIGHT_DRIFT, f"light or focus: the white ratio changed by {drift_grey:.0f} levels everywhere"
    )
