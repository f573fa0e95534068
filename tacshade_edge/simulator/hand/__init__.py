"""Fingers at known poses and the one object that they hold."""
