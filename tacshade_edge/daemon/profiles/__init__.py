"""Which profile runs, and who chose it."""
