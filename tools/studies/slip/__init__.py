"""Slip over time: how soon it is reported, and how often falsely."""
