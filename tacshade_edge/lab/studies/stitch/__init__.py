"""Stitch posed images offline: Experiment 2 of the paper."""
