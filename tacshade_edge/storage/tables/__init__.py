"""Tables of presses, labels, poses and frames; the folder that `capture` fills."""
