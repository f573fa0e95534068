"""Strict YAML settings."""
