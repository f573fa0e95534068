"""Long jobs over many frames: how good a reconstruction is, and what it costs."""
