"""Presses by a 3-D printer: its line, its head, what the camera says to each step, and the order of it all."""
