"""Publishes results, maps and health."""
