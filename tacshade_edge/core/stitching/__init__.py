"""Stitch many presses into one map of a surface."""
