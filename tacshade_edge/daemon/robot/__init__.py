"""The robot next to the sensor: its line, clock and commands."""
