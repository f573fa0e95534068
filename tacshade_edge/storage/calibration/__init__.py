"""Calibrations on disk, and the reference that a daemon was asked to take."""
