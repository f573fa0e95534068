"""The hand's own process, and the lines between it and the sensors' processes."""
