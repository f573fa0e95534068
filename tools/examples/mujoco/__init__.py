"""Simulated robots with a sensor in MuJoCo."""
