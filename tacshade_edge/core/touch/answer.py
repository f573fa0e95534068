"""Compute a frame's touch by the calibration's model, or without one from height map and shear."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tacshade_edge.core.touch.imprint import belongs
from tacshade_edge.core.touch.model import predict
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, Touch, TouchedObject, TouchModel

MARGIN = 1.645
"""A value this many standard deviations beyond the labelled range is an extrapolation."""

PLAIN = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
"""Names of the quantities that need no labels."""

PLAIN_SIGMA = (0.4, 5.0, 5.0, 1.0, 1.0, 4.0)
"""Standard deviation of each without labels. Plates on a sensor of the third family have less: 0.28, 1.1, 1.1, 0.34,
0.42, 2.9 (tools/studies/third_family/touch.py); other objects and real skins are worse."""


def touch_by_model(model: TouchModel, features: F32, imprint: F32) -> Touch:
    """The touch that a model predicts from a frame's features, float32 (D,), and its imprint (`imprint_of`)."""
    found = predict(model, features)
    alike = found.alike and belongs(model, found.values, imprint)
    if not alike:
        unknown = dict.fromkeys(model.names)
        text = (
            "the imprint is unlike the labelled object's imprint"
            if found.alike
            else "the frame is unlike any labelled frame"
        )
        return Touch(unknown, unknown, Reason(ReasonCode.TOUCH_UNLIKE, text))
    values, sigma = found.values.tolist(), found.sigma.tolist()
    margin = MARGIN * found.sigma
    outside = (found.values < model.low - margin) | (found.values > model.high + margin)
    names = [name for name, out in zip(model.names, outside, strict=True) if out]
    reason = Reason(ReasonCode.TOUCH_RANGE, f"outside the labelled range: {', '.join(names)}") if names else None
    return Touch(
        {name: None if name in names else value for name, value in zip(model.names, values, strict=True)},
        {name: None if name in names else value for name, value in zip(model.names, sigma, strict=True)},
        reason,
    )


def touch_without_labels(objects: Sequence[TouchedObject], shear_mm: tuple[float, float] | None) -> Touch:
    """The touch without a model: greatest depth, tilt of the largest object's plane and its twist, and mean shear."""
    first = objects[0]
    x, y, z = first.normal
    tilt_x_deg, tilt_y_deg = -math.degrees(math.asin(max(-1.0, min(1.0, y)))), math.degrees(math.atan2(x, z))
    shear = (None, None) if shear_mm is None else shear_mm
    depth_mm = max(one.depth_max_mm for one in objects)
    values = dict(zip(PLAIN, (depth_mm, tilt_x_deg, tilt_y_deg, *shear, first.twist_deg), strict=True))
    sigma = dict(zip(PLAIN, PLAIN_SIGMA, strict=True))
    return Touch(values, {name: None if values[name] is None else one for name, one in sigma.items()})
