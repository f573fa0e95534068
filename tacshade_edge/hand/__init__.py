"""Combines what the fingers of a hand report. Pure: the daemon and the library pass in the time."""
