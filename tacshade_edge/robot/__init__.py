"""The robot's serial line: poses, clock and commands in, answers and events out.

In: bytes of a port. Out: poses on the daemon's clock, requests, answers.
Threads: `serial`.
Other rooms use: `port`, `ports`, `pose_buffer`, `robot`, `verbs`.
"""
