"""Opens what the settings name as source: V4L2, rpicam, files, the simulated sensor.

In: a device, files. Out: a `Frame` at a time.
Threads: none.
Other rooms use: `frame_source`, `rpicam`, `sources`, `v4l2`, `v4l2_node`.
"""
