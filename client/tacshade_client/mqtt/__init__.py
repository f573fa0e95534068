"""Connects to a broker."""
