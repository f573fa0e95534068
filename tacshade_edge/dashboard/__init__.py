"""The dashboard: a small server for one static page, and the page itself in ``static/``.

A process of its own, which nothing of the daemon needs. It knows files and bytes: what a message means is the
page's business.
"""
