"""A simulated robot that presses the simulated sensor on a surface or an edge; a fake
``rpicam-vid`` shows its view.
"""
