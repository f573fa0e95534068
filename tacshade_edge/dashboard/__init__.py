"""Serves the page, and passes on the broker's messages to it.

In: a broker's address, recordings. Out: HTTP and WebSockets.
Threads: asyncio's.
Other rooms use: `relay`, `server`.
"""
