"""What every finding of `doctor` has to be."""

from __future__ import annotations

from collections.abc import Iterable

from tacshade_edge.doctor import Finding


def checked(findings: Iterable[Finding]) -> list[Finding]:
    """The findings; each is one line, and says what to do exactly if something is wrong."""
    found = list(findings)
    for finding in found:
        assert bool(finding.fix) == (finding.state != "ok"), finding
        assert "\n" not in finding.found + finding.fix, finding
    return found


def states(findings: Iterable[Finding]) -> list[str]:
    return [finding.state for finding in checked(findings)]
