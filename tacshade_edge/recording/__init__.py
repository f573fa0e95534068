"""Recordings: PNG files or MCAP, their table, events and contents; runs and exports.

In: frames and their times and poses. Out: folders and files, and frames again.
Threads: none.
Other rooms use: `exports.mcap_export`, `exports.table_export`, `frame_table`, `mcap`, `recorder`,
    `recording`, `recording_content`, `runs`, `video`.
"""
