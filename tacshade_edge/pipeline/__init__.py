"""The way of each frame: grabbed, reconstructed, shown to observers, counted once.

In: a frame source, a reconstructor, observers. Out: `FrameResult`s, counts, timings.
Threads: `grab`, `reconstruct`.
Other rooms use: `ledger`, `observer`, `pipeline`.
"""
