"""Experiment 1 of the paper, and a user's own images, scored against ground truth."""
