"""Images of the unloaded skin: circle, markers, threshold, load, and following."""
