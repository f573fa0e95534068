"""Trains the shipped networks further with a sensor's own presses;
the only part that needs PyTorch (extra ``fit``).
"""
