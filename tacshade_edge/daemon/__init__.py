"""The running sensor: wires camera, reconstruction, broker, robot and recorder together.

In: settings and a calibration. Out: a process; `supervisor` forks one for each of several sensors.
Threads: `record`; those of the rooms that it wires.
Other rooms use: `app`, `board_backup`, `hand_process`, `named_files`, `playback`, `supervisor`.
"""
