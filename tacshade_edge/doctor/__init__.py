"""Finds what is wrong with a sensor and its machine, and what fixes it; a finding is one line of the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "fault"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a check, of which several may share a name.

    With a ``fault`` the daemon cannot work; with a ``warning`` it works, but worse than it could. `fix` says what to
    do, with the exact command if there is one; it is empty if all is well.
    """

    check: str
    state: State
    found: str
    fix: str = ""


def ok(check: str, found: str) -> Finding:
    """Return the finding that all is well."""
    return Finding(check, "ok", found)


def warning(check: str, found: str, fix: str) -> Finding:
    """Return the finding that the daemon works, but worse than it could."""
    return Finding(check, "warning", found, fix)


def fault(check: str, found: str, fix: str) -> Finding:
    """Return the finding that the daemon cannot work like this."""
    return Finding(check, "fault", found, fix)
