"""Fingers at known places and the one object that they hold."""
