"""A robot that presses the simulated sensor on a surface or an edge, behind a stand-in for ``rpicam-vid``."""
