"""The daemon on trial: a run of some seconds on pictures in memory, heard by a subscriber."""
