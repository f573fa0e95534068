"""Writes and reads recordings, as PNG files or as MCAP."""
