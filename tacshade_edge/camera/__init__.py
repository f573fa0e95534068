"""What the settings may name as source, and how it is opened: V4L2, rpicam, files, the simulated
sensor.

In: a device, files. Out: a `Frame` at a time.
Threads: none.
Other rooms use: `csi_camera`, `frame_source`, `sources`, `v4l2`, `v4l2_node`.
"""
