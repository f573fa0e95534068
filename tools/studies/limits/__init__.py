"""Study the limits of reconstruction: phantoms, least and greatest depth, finest shape, disturbed frames."""
