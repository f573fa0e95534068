"""What a controller needs of a touch: a few numbers, by a model that a calibration learnt from labelled frames."""
