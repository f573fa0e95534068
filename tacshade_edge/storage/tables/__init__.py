"""Tables of presses, labels, poses and frames, and the folder that `capture` fills."""
