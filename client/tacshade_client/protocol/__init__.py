"""Bytes to values. No I/O."""
