"""The only package with threads and wiring."""
