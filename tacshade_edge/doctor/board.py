"""Checks the board: power, heat and the processor's governor. No finding if the machine reports none of these."""

from __future__ import annotations

from tacshade_edge.doctor.finding import Finding, ok, warning
from tacshade_edge.doctor.machine import Machine

_THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
_CPU = "/sys/devices/system/cpu/cpu0/cpufreq"
# Bits of get_throttled for the present state; the same bits 16 higher are for the time since boot.
_UNDER_VOLTAGE, _CAPPED, _SLOWED, _HOT = 1, 2, 4, 8
_OWN_SCALING = ("intel_pstate", "amd-pstate-epp")  # their `powersave` follows the load


def check_board(machine: Machine) -> tuple[Finding, ...]:
    """Findings on what a Raspberry Pi's firmware reports and on the kernel's frequency scaling."""
    return (*_power(machine), *_governor(machine))


def _power(machine: Machine) -> tuple[Finding, ...]:
    text = machine.read(_THROTTLED)
    if not text:
        return ()
    flags = int(text, 16)
    found = []
    for bits, what, fix in (
        (_UNDER_VOLTAGE, "under-voltage", "use the board's own power supply and a short thick cable"),
        (_CAPPED | _SLOWED | _HOT, "slowed down", "cool it (heat sink, fan, open case) and check its power supply"),
    ):
        if flags & bits:
            found.append(warning("board", f"{what} now; frames will be late or lost", fix))
        elif flags >> 16 & bits:
            found.append(warning("board", f"{what} at some time since boot, but not now", fix))
    return tuple(found) or (ok("board", "power and temperature have been fine since boot"),)


def _governor(machine: Machine) -> tuple[Finding, ...]:
    governor = machine.read(f"{_CPU}/scaling_governor")
    if governor != "powersave" or machine.read(f"{_CPU}/scaling_driver") in _OWN_SCALING:
        return ()
    fix = "echo ondemand | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
    return (warning("board", "the powersave governor keeps the processor at its lowest speed", fix),)
