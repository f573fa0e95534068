"""Fit networks to a sensor's presses, and measure their errors."""
