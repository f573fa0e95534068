"""Finds what is wrong with a sensor and its machine, and what fixes it: one small file per subject."""
