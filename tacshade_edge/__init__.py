"""Metric shape from touch on a small board, for TacShade optical tactile sensors."""

__version__ = "0.1.0"
