"""Families of sensors that training never sees and that judge it (README.md)."""
