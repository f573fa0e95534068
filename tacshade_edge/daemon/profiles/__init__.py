"""Chooses the profile that runs, and keeps its reconstructor."""
