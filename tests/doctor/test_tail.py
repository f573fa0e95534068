from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tacshade_edge.doctor.tail import Tail, check_tail, measure_tail

QUIET = Tail(
    pieces=600,
    p50_ms=4.1,
    p99_ms=4.4,
    worst_ms=6.0,
    processor_p50_ms=4.0,
    processor_p99_ms=4.2,
)
BUSY = replace(QUIET, p99_ms=18.5, worst_ms=21.7)
SLOW = replace(BUSY, processor_p99_ms=17.0)
FIFO, OTHER = ("1 (tacshade edge) S " + " ".join(["0"] * 37) + f" {policy} 0" for policy in (1, 0))


def fixes(machine: Any, tail: Tail) -> list[str]:
    return [finding.fix for finding in check_tail(machine, tail)]


def test_work_is_measured_at_its_rhythm() -> None:
    tail = measure_tail(work_ms=1.0, rate_hz=200.0, seconds=0.1)
    assert tail.pieces == 20
    assert 0.3 < tail.processor_p50_ms < 3
    assert tail.p50_ms <= tail.p99_ms <= tail.worst_ms


def test_a_quiet_machine_has_no_tail(machine: Any) -> None:
    (finding,) = check_tail(machine, QUIET)
    assert finding.state == "ok"
    assert "99 % within 4.4 ms (1.1 times)" in finding.found


def test_work_that_always_waits_has_a_tail_though_its_median_is_as_late(machine: Any) -> None:
    assert check_tail(machine, replace(BUSY, p50_ms=10.6))[0].state == "warning"


@pytest.mark.parametrize(
    ("tail", "cause"),
    [(BUSY, "other programs had the processor"), (SLOW, "the processor itself was slower")],
)
def test_a_tail_has_a_cause(machine: Any, tail: Tail, cause: str) -> None:
    finding = check_tail(machine, tail)[0]
    assert finding.state == "warning"
    assert cause in finding.found


def test_a_daemon_without_priority_gets_one(machine: Any) -> None:
    machine.process(7, "python3", "tacshade-edge", "run")
    machine.put("/proc/7/stat", OTHER)
    assert "CPUSchedulingPolicy=fifo" in fixes(machine, BUSY)[1]
    machine.put("/proc/7/stat", FIFO)
    assert not any("CPUSchedulingPolicy" in fix for fix in fixes(machine, BUSY))


def test_what_helps_is_named_with_its_command(machine: Any) -> None:
    machine.put("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "ondemand")
    machine.put("/proc/cpuinfo", "flags : fpu hypervisor lahf_lm")
    machine.put("/proc/meminfo", "SwapTotal: 2048000 kB\nSwapFree: 1024000 kB\n")
    for k in range(4):
        machine.put(f"/sys/devices/system/cpu/cpu{k}/online", "1")
    machine.put("/sys/devices/system/cpu/isolated", "")
    found = " ".join(fixes(machine, BUSY))
    for word in ("echo performance", "cores of its own", "swapoff", "isolcpus=3", "CPUAffinity=3"):
        assert word in found
    assert "echo performance" in fixes(machine, SLOW)[1], "its clock first if the processor is slow"
    machine.put("/sys/devices/system/cpu/isolated", "3")
    machine.put("/proc/meminfo", "SwapTotal: 2048000 kB\nSwapFree: 2048000 kB\n")
    rest = " ".join(fixes(machine, BUSY))
    assert "swapoff" not in rest
    assert "isolcpus" not in rest
