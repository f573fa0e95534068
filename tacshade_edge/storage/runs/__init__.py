"""What `reconstruct` and `replay` leave, and two runs compared."""
