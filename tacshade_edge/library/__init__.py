"""What `import tacshade_edge` offers.

In: images, cameras, recordings, a broker. Out: `Result`s.
Threads: paho's, for `listen`.
Other rooms use: `frames`, `result`, `run_messages`, `sensor`, `subscriber`.
"""
