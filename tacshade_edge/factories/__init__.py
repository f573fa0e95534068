"""From settings to what they name: sources, ports, links, calibrations."""
