"""Stitching sessions and maps on disk."""
