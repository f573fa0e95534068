"""Loops closed on a touch: follow a surface, follow an edge."""
