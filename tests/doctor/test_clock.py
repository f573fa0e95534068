from __future__ import annotations

import pytest

from tacshade_edge.doctor.clock import check_clock, judge, synchronised

NOW_S, INSTALLED_S = 1_800_000_000.0, 1_790_000_000.0


@pytest.mark.parametrize(
    ("now_s", "synced", "resolution_s", "states", "said"),
    [
        (NOW_S, True, 1e-9, ["ok"], "2027-01-15 08:00 UTC, synchronised"),
        (NOW_S, None, 1e-9, ["ok"], "does not report"),
        (NOW_S, False, 1e-9, ["warning"], "not synchronised"),
        (0.0, True, 1e-9, ["fault"], "the date is 1970-01-01 00:00 UTC, but this program was installed on 2026-09-21"),
        (NOW_S, True, 0.004, ["ok", "warning"], "steps of 4000 µs"),
    ],
)
def test_judged(now_s: float, synced: bool | None, resolution_s: float, states: list[str], said: str) -> None:
    findings = judge(now_s, INSTALLED_S, synced, resolution_s)
    assert [finding.state for finding in findings] == states
    assert said in findings[-1].found
    assert all(bool(finding.fix) == (finding.state != "ok") for finding in findings)


def test_this_machines_clock_answers() -> None:
    assert synchronised() in (True, False)
    assert check_clock()[0].check == "clock"
    assert check_clock()[0].state in ("ok", "warning"), "this machine knows its year"
