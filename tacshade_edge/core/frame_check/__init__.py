"""Whether a frame can be used: light, torn frames, a camera that shifted."""
