"""Stitching sessions."""
