"""Recordings: written, read, as PNG files or as MCAP."""
