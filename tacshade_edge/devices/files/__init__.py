"""Files: images, tables, calibrations, recordings, sessions, maps."""
