"""The fault bench: faults of the daemon and its files,
with the required outcomes (``python -m tools.faults``).
"""
