"""A press as its image shows it, and as a machine places it."""
