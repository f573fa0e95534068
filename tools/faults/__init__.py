"""The fault bench: what is done to the daemon and its files, and what must come of it (``python -m tools.faults``)."""
