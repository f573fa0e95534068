"""Guides a person, or a robot, through references, presses, touches and labelled frames.

In: a camera's frames, what a person types, a scale, a robot's poses. Out: a folder that `calibrate`
    reads.
Threads: `page`, `scale`.
Other rooms use: `capture_session`, `label_session`, `live`, `page`, `robot_place`, `scale`.
"""
