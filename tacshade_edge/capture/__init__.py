"""Takes a sensor's references and presses, which `calibrate` reads,
in a dialogue with the person who presses.
"""
