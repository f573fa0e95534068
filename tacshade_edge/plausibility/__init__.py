"""Judges whether numbers of a table or a stream can be in the unit that they are read in.

In: what was read, and what the sensor is or sees. Out: suspicions, as codes with values.
Threads: none.
Other rooms use: `frame_times`, `hand_places`, `label_columns`, `pose_tables`,
    `row_order`, `stated_circle`, `stream_clock`, `stream_places`, `suspicions`.
"""
