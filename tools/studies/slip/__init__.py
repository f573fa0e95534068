"""Slip over time: told how soon, and how often where nothing slides."""
