"""Many presses to one map of a surface."""
