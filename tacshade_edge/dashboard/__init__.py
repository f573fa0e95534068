"""The dashboard: a small server for one static page, and the page itself in ``static/``.

It is a separate process on which the daemon does not depend. The server handles files and bytes; the page interprets
the messages.
"""
