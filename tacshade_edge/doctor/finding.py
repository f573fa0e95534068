"""One line of the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "fault"]


@dataclass(frozen=True, slots=True)
class Finding:
    """What one check found.

    Attributes
    ----------
    check : str
        Its name; several findings may share one.
    state : str
        ``fault``: the daemon cannot work so. ``warning``: it works, worse than it could.
    found : str
        One line for a person.
    fix : str
        What to do, with the exact command where there is one; empty when `state` is ``ok``.
    """

    check: str
    state: State
    found: str
    fix: str = ""


def ok(check: str, found: str) -> Finding:
    """All is well."""
    return Finding(check, "ok", found)


def warning(check: str, found: str, fix: str) -> Finding:
    """It works, worse than it could."""
    return Finding(check, "warning", found, fix)


def fault(check: str, found: str, fix: str) -> Finding:
    """It cannot work so."""
    return Finding(check, "fault", found, fix)
