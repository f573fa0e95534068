"""Where a pixel looks: the visible disc, its grids and rays, and back-projection onto the skin."""
