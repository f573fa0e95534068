"""Find contact and objects: the gate, outlines, tracking."""
