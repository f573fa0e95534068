"""Checks the clocks: the wall clock dates messages and recordings, the monotonic clock times them."""

from __future__ import annotations

import ctypes
import time
from pathlib import Path

from tacshade_edge.doctor.finding import Finding, fault, ok, warning

_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised
_TIMEX_BYTES = 512  # struct timex has at most 208; all zero, it reads the state and changes nothing
_FINE_S = 1e-6
_DAY_S = 86400


def check_clock() -> tuple[Finding, ...]:
    """Check this machine's clocks."""
    installed_s = Path(__file__).stat().st_mtime
    return judge(time.time(), installed_s, synchronised(), time.get_clock_info("monotonic").resolution)


def synchronised() -> bool | None:
    """Whether any program synchronises the kernel's clock, with or without systemd; None if the kernel reports none."""
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    return None if state < 0 else state != _TIME_ERROR


def judge(now_s: float, installed_s: float, synced: bool | None, resolution_s: float) -> tuple[Finding, ...]:
    """Findings on the wall clock's time, its synchronisation, and the monotonic clock's resolution."""
    today = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(now_s))
    keep = "connect to a network and run: sudo timedatectl set-ntp true (without systemd: install chrony)"
    if now_s < installed_s - _DAY_S:
        since = time.strftime("%Y-%m-%d", time.gmtime(installed_s))
        found = f"the date is {today}, but this program was installed on {since}, so times and file names will be wrong"
        wall = fault(
            "clock", found, f"{keep}; a board without a battery-backed clock loses the time when it is switched off"
        )
    elif synced is False:
        found = (
            f"{today}, not synchronised: times in messages and recordings may be wrong; measurements are not affected"
        )
        wall = warning("clock", found, keep)
    else:
        known = "synchronised" if synced else "the kernel does not report whether the clock is synchronised"
        wall = ok("clock", f"{today}, {known}")
    if resolution_s <= _FINE_S:
        return (wall,)
    coarse = f"the monotonic clock counts in steps of {1e6 * resolution_s:g} µs"
    return wall, warning("clock", coarse, "boot a kernel with high-resolution timers (remove highres=off)")
