"""Cameras as frame sources: V4L2, rpicam and simulated."""
