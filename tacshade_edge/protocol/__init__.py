"""Encode values to bytes and decode bytes to values: pure functions without I/O."""
