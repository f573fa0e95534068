"""Measures the machine's own tail: how late it ends the same work at a camera's rhythm.

Every latency has two parts: what the program computes, and how often the machine makes it wait.
This measures the second alone, with plain matrix products in place of the program's frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacshade_edge.doctor import Finding, Findings, ok, warning
from tacshade_edge.doctor.machine import Machine

CHECK = "tail"
WORK_MS, RATE_HZ, SECONDS = 4.0, 60.0, 10.0
"""A frame in contact on a desktop, a usual camera's rate, and enough pieces for a p99."""
TAILED = 2.0
"""A p99 of more than this many times the work's own time is a tail: a quiet machine has 1.1."""
SLOWER = 1.5
"""Processor time at p99 of more than this many times its median: the processor itself is slower
then, not the scheduler.
"""
_SIDE = 64
"""So small that no BLAS starts threads for it, whose waiting would be measured as well."""
_CPU = "/sys/devices/system/cpu"
# Counted behind the command, whose name may contain spaces.
_POLICY, _REAL_TIME = 41 - 3, (1, 2)
"""The place of the scheduling policy in stat(5) behind the command, and FIFO and RR."""
_MANY_CORES = 4
"""With fewer, a core that only one process may use is missed by all others."""


@dataclass(frozen=True, slots=True)
class Tail:
    """Pieces of the same work: their wall times, and processor times, in milliseconds."""

    pieces: int
    p50_ms: float
    p99_ms: float
    worst_ms: float
    processor_p50_ms: float
    processor_p99_ms: float

    @property
    def ratio(self) -> float:
        """The p99 as a multiple of the processor time that the work usually needs."""
        return self.p99_ms / self.processor_p50_ms

    @property
    def processor_is_slower(self) -> bool:
        """Whether slow pieces cost more processor time as well."""
        return self.processor_p99_ms > SLOWER * self.processor_p50_ms


def measure_tail(
    work_ms: float = WORK_MS, rate_hz: float = RATE_HZ, seconds: float = SECONDS
) -> Tail:
    """Work for `work_ms` of processor time at each tick of `rate_hz`, for some seconds."""
    piece = _piece(work_ms)
    period_s, pieces = 1 / rate_hz, max(int(seconds * rate_hz), 1)
    wall_ms, processor_ms = np.empty(pieces), np.empty(pieces)
    due_s = time.monotonic()
    for k in range(pieces):
        due_s += period_s
        time.sleep(max(0.0, due_s - time.monotonic()))
        # From the tick, not from the wake-up: a frame waits for a late wake-up too.
        began_ns = time.thread_time_ns()
        piece()
        processor_ms[k] = (time.thread_time_ns() - began_ns) / 1e6
        wall_ms[k] = (time.monotonic() - due_s) * 1e3
        # One late piece must not make all that follow late: a camera drops frames then, too.
        due_s = max(due_s, time.monotonic() - period_s)
    return Tail(
        pieces=pieces,
        p50_ms=float(np.percentile(wall_ms, 50)),
        p99_ms=float(np.percentile(wall_ms, 99)),
        worst_ms=float(wall_ms.max()),
        processor_p50_ms=float(np.percentile(processor_ms, 50)),
        processor_p99_ms=float(np.percentile(processor_ms, 99)),
    )


def check_tail(machine: Machine, tail: Tail) -> Findings:
    """Judge a tail, and name what shortens it on this machine."""
    found = (
        f"work of {tail.processor_p50_ms:.1f} ms, {tail.pieces} times: half within "
        f"{tail.p50_ms:.1f} ms, 99 % within {tail.p99_ms:.1f} ms ({tail.ratio:.1f} times), "
        f"worst {tail.worst_ms:.1f} ms"
    )
    if tail.ratio <= TAILED:
        return (ok(CHECK, found),)
    cause = (
        "the processor itself was slower then"
        if tail.processor_is_slower
        else "other programs had the processor then"
    )
    return (warning(CHECK, f"{found}; {cause}", "see the lines below"), *helps(machine, tail))


def helps(machine: Machine, tail: Tail) -> tuple[Finding, ...]:
    """What shortens a tail here, the likeliest first: of a slower processor its clock and its
    host, of a busy one priorities and cores.
    """
    clock, turns = _clock_helps(machine), _turn_helps(machine)
    return (*clock, *turns) if tail.processor_is_slower else (*turns, *clock)


def _clock_helps(machine: Machine) -> list[Finding]:
    found = []
    governor = machine.read(f"{_CPU}/cpu0/cpufreq/scaling_governor")
    if governor and governor != "performance":
        fix = f"echo performance | sudo tee {_CPU}/cpu*/cpufreq/scaling_governor"
        slow = "a piece that follows a rest begins at a low clock"
        found.append(warning(CHECK, f"the {governor} governor: {slow}", fix))
    if "hypervisor" in machine.read("/proc/cpuinfo").split():
        host = "give this guest cores of its own there; nothing inside it helps"
        found.append(warning(CHECK, "a virtual machine: its host decides when it runs", host))
    return found


def _turn_helps(machine: Machine) -> list[Finding]:
    found = []
    if not _is_real_time(machine):
        drop_in = (
            "sudo systemctl edit tacshade-edge, [Service] CPUSchedulingPolicy=fifo and "
            "CPUSchedulingPriority=10"
        )
        found.append(warning(CHECK, "no real-time priority: any program may come between", drop_in))
    swap = dict(
        line.split(":") for line in machine.read("/proc/meminfo").splitlines() if ":" in line
    )
    total, free = (int(swap.get(f"Swap{what}", "0").split()[0]) for what in ("Total", "Free"))
    if free < total:
        fix = "sudo swapoff -a, or MemorySwapMax=0 in the unit's drop-in"
        found.append(warning(CHECK, f"{(total - free) // 1024} MB are swapped out", fix))
    cores = machine.names(_CPU, "cpu[0-9]*")
    if len(cores) >= _MANY_CORES and not machine.read(f"{_CPU}/isolated"):
        fix = (
            f"isolcpus={len(cores) - 1} in the kernel's command line, and "
            f"CPUAffinity={len(cores) - 1} in the unit's drop-in"
        )
        found.append(warning(CHECK, "no core is kept for the daemon", fix))
    return found


def _is_real_time(machine: Machine) -> bool:
    """Whether the running daemon has a real-time priority; without one, nobody has."""
    daemon = machine.daemon()
    stat = machine.read(f"/proc/{daemon.pid}/stat") if daemon else ""
    # proc(5): the command, in parentheses, may contain spaces; the policy is field 41.
    after_command = stat.rpartition(")")[2].split()
    return len(after_command) > _POLICY and int(after_command[_POLICY]) in _REAL_TIME


def _piece(work_ms: float) -> Callable[[], None]:
    """A function that computes for about `work_ms` of processor time."""
    a = np.full((_SIDE, _SIDE), 0.5, np.float32)
    b, c = np.eye(_SIDE, dtype=np.float32), np.empty((_SIDE, _SIDE), np.float32)

    def products(count: int) -> None:
        for _ in range(count):
            np.dot(a, b, out=c)

    products(100)  # wakes the clock
    tried, began_ns = 500, time.thread_time_ns()
    products(tried)
    each_ms = (time.thread_time_ns() - began_ns) / 1e6 / tried
    count = max(1, round(work_ms / each_ms))
    return lambda: products(count)
