"""Where the reconstruction ends: phantoms, the least and the greatest depth, the finest shape, disturbed frames."""
