"""Presses by a 3-D printer: its serial line, its head, the camera's check of each step, and the whole sequence."""
