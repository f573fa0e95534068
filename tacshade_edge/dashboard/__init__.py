"""The dashboard: a small server, apart from the daemon,
for one static page that interprets the messages.
"""
