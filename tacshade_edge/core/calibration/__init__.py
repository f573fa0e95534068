"""Make a calibration from references and presses, and grade it."""
