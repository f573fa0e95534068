"""Builds what the settings name: sources, ports, links, calibrations."""
