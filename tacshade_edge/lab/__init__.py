"""What shows, simulates and measures: nothing that a running sensor needs."""
