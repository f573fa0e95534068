"""Finds what is wrong with a sensor and its machine, and what fixes it.

In: settings, devices, the broker, pictures. Out: findings, each a line of the report.
Threads: one for each check that may hang.
Other rooms use: `board`, `bundle`, `camera_check`, `diagnose`, `judged_pictures`, `machine`,
    `tail`.
"""

from tacshade_edge.finding import Finding, Findings, State, fault, ok, warning

__all__ = ["Finding", "Findings", "State", "fault", "ok", "warning"]
