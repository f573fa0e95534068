"""Combines what the fingers of one hand touch, live and from recordings. Pure but for
`hand_recordings`.

In: the fingers' reports. Out: the hand's objects.
Threads: none.
Other rooms use: `fingers`, `hand_recordings`.
"""
