"""What the simulated sensor has for tests and studies alone."""
