"""Calibrations on disk, and the references that a running daemon took."""
