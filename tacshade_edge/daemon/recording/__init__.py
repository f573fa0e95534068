"""Recordings of the running daemon, and their replay."""
