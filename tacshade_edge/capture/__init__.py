"""Taking references and presses of a sensor, with the person who presses: what `calibrate` then reads."""
