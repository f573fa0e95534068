"""Check whether a frame can be used: light, torn frames, a shifted camera."""
