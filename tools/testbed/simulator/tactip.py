"""A TacTip, simulated as another print on the same skin."""

from __future__ import annotations

from dataclasses import replace

from tacshade_edge.simulator.model import SensorModel


def tactip(model: SensorModel) -> SensorModel:
    """Print the same skin as a TacTip: white pin tips on black, without markers, so that contact darkens the image."""
    return replace(
        model,
        pin_length_pitches=1.0,
        pin_tip_radius_pitches=0.26,
        pin_base_radius_pitches=0.26,
        marker_reflectance=model.skin_reflectance,
        pin_reflectance=model.skin_reflectance,
        pin_tip_reflectance=0.95,
    )
