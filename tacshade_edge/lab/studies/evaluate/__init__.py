"""Score Experiment 1 of the paper, and a user's own images, against ground truth."""
