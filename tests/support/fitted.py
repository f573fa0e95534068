"""Calibrations with their own weights, without training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import load_network, network_files, shipped_layout
from tacshade_edge.inference.onnx_weights import values_of
from tacshade_edge.types import Calibration, FittedNetwork


def fitted_network(profile: str, by: float = 0.0, layout: str | None = None) -> FittedNetwork:
    """The shipped weights, all of them and the correction greater by a number."""
    name = PROFILES[profile].network
    assert name is not None
    weights = np.concatenate([values_of(data) for data in network_files(name)])
    side = PROFILES[profile].cells // load_network(name).fold
    channels = {"accurate": 16, "balanced": 16, "fast": 32}[name]
    correction = np.full((channels, side, side), by, np.float32)
    return FittedNetwork(
        layout or shipped_layout(name), weights + np.float32(by), correction, 8, error_mm=0.2, shipped_error_mm=0.4
    )


def fitted_with(profile: str, calibration: Calibration, by: float = 0.0, layout: str | None = None) -> Calibration:
    """A calibration with `fitted_network`."""
    return replace(calibration, fitted={profile: fitted_network(profile, by, layout)})
