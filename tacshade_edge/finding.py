"""What a check of a sensor and its machine found."""

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
