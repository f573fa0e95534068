"""Whether anything touches, and what: the gate, outlines, objects."""
