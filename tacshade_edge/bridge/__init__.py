"""Translates what sensors publish for other programs: Foxglove's viewers, Prometheus, ROS 2.

In: messages from the broker. Out: a WebSocket's or an HTTP server's answers, a Zenoh network's
    samples.
Threads: `viewers`, `metrics`; Zenoh's own.
Other rooms use: `expected_sensors`, `foxglove`, `prometheus`, `ros2`.
"""
