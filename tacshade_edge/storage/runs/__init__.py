"""The files that `reconstruct` and `replay` write, and the comparison of two runs."""
