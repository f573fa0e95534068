"""What is wrong with a sensor and its machine, and what mends it: one small file per subject."""
