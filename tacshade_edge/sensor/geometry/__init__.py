"""The visible disc, its grids and rays, and back-projection of pixels onto the skin."""
