"""Decodes bytes to values. No I/O."""
