"""Ask the user about a press that differs from its stated values, while the indenter is still there."""

from __future__ import annotations

import math

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_view import PressView
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import Geometry

# Ratios of seen to true sizes are within these on sensors of both families. A larger ball raises a question only if the
# stated one fits this many times worse; shallower presses (mm on the nominal skin) do not show the radius.
_BALL_FACTORS, _MISFIT_RATIO, _BALL_DEPTH_MM = (0.7, 2.0), 4.0, 0.8
# The network finds a place within 1.2 mm on the nominal skin.
_PLACE_MM = 2.5
_DEPTH_FACTORS = (0.33, 2.5)


def question(view: PressView, press: KnownPress, geometry: Geometry) -> str:
    """A question about the value that differs from the image; empty if none differs by much."""
    scale = skin_scale(geometry)
    if not _DEPTH_FACTORS[0] < view.depth_mm / press.depth_mm < _DEPTH_FACTORS[1] and press.depth_mm > 0.5 * scale:
        return f"looks about {view.depth_mm:.1f} mm deep; is the depth of {press.depth_mm:g} mm right?"
    smaller = view.ball_factor < _BALL_FACTORS[0]
    larger = view.ball_factor > _BALL_FACTORS[1] and view.misfit_ratio > _MISFIT_RATIO
    if press.depth_mm > _BALL_DEPTH_MM * scale and (smaller or larger):
        shown = f"looks like a ball of {view.ball_factor * press.radius_mm:.0f} mm"
        asked = f"is {press.radius_mm:g} its diameter?" if smaller else f"is its radius {press.radius_mm:g}?"
        return f"{shown}; {asked}"
    if press.x_mm is None or press.y_mm is None:
        return ""
    if math.hypot(view.x_mm - press.x_mm, view.y_mm - press.y_mm) <= _PLACE_MM * scale:
        return ""
    swapped = math.hypot(view.x_mm - press.y_mm, view.y_mm - press.x_mm) <= _PLACE_MM * scale
    asked = "are x and y swapped?" if swapped else f"is x {press.x_mm:g}, y {press.y_mm:g} right?"
    return f"the picture shows it around x {view.x_mm:.0f}, y {view.y_mm:.0f} mm; {asked}"
