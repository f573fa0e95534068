"""The third family of sensors, whose skin MuJoCo solves and which only judges networks
(README.md).
"""
