"""Arithmetic on height maps."""
