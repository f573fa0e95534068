"""Translates what sensors publish for other programs: Foxglove's viewers, Prometheus.

In: messages from the broker. Out: a WebSocket's or an HTTP server's answers.
Threads: `viewers`, `metrics`.
Other rooms use: `foxglove`, `prometheus`.
"""
