"""Finds what is wrong with a sensor and its machine, and what fixes it.

In: settings, devices, the broker, pictures. Out: findings, each a line of the report.
Threads: one for each check that may hang.
Other rooms use: `board`, `bundle`, `camera_check`, `diagnose`, `judged_pictures`, `machine`,
    `tail`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "fault"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a check; with a ``fault`` the daemon cannot work,
    with a ``warning`` worse than it could.
    """

    check: str
    state: State
    found: str
    fix: str = ""


Findings = tuple[Finding, ...]


def ok(check: str, found: str) -> Finding:
    return Finding(check, "ok", found)


def warning(check: str, found: str, fix: str) -> Finding:
    return Finding(check, "warning", found, fix)


def fault(check: str, found: str, fix: str) -> Finding:
    return Finding(check, "fault", found, fix)
