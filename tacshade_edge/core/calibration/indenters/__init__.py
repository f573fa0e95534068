"""Shapes that press: balls and others, and such to print."""
