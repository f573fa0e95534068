"""Serves what sensors publish in other tools' protocols;
a separate process, so the daemon has one more subscriber.
"""
