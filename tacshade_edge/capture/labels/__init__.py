"""Takes labelled frames: matches typed readings, a scale's readings and a robot's poses to the pictures."""
