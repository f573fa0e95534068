"""Where a pixel looks, and where the skin is there."""
