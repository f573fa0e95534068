"""The robot beside the sensor: its line, its clock, its commands."""
