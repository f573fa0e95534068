"""How well the standard deviations of heights hold."""
