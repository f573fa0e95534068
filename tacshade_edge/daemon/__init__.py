"""The only place with threads and wiring."""
