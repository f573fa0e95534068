"""Reads and writes this program's files, whole or not at all;
a file that cannot be used gives one clear line.
"""
