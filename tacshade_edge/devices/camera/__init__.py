"""Frames from cameras: V4L2, and the simulated one."""
