"""A data set of LeRobot from a running sensor, as a camera of its own kind."""
