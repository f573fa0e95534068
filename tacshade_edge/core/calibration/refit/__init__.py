"""Networks fitted to a sensor's presses, and how far off they are."""
