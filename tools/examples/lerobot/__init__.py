"""Record a LeRobot data set from a running sensor, which LeRobot reads as a camera."""
