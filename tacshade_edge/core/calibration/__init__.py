"""From references and presses to a calibration, and how good it is."""
