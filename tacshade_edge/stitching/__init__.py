"""Stitches presses into one map of a surface: map, refinement, flange, session, files.

In: frames with poses. Out: a session's files and its map.
Threads: `stitch`.
Other rooms use: `average`, `flange`, `map_files`, `press_agreement`, `press_points`, `refinement`,
    `session_worker`, `stitcher`.
"""
