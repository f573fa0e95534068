"""Facts about a board for benchmark figures that users send in: no serial number, address or person's name."""

from __future__ import annotations

import os
import platform
import re

from tacshade_edge.doctor.machine import Machine
from tacshade_edge.quoting import escaped
from tacshade_edge.version import installed_version

MODEL = "/proc/device-tree/model"
THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
_CPU = "/sys/devices/system/cpu/cpu0/cpufreq"
# Arm's "CPU part" in /proc/cpuinfo for the boards that the documents name.
_ARM_PARTS = {"0xd03": "Cortex-A53", "0xd08": "Cortex-A72", "0xd0b": "Cortex-A76"}
# Bits of get_throttled for the time since boot, after a shift right by 16.
_SINCE_START = {1: "under-voltage", 2: "capped", 4: "throttled", 8: "hot"}
_TEXT_MAX = 80


def board_facts(machine: Machine) -> dict[str, str]:
    """Return board, processor and software by name, without what cannot be read."""
    cpuinfo, release = machine.read("/proc/cpuinfo"), machine.read("/etc/os-release")
    part = _field(cpuinfo, "CPU part")
    cores = len(os.sched_getaffinity(0))
    mhz = machine.read(f"{_CPU}/cpuinfo_max_freq")
    facts = {
        "board": machine.read(MODEL).rstrip("\0") or f"{platform.machine()} machine",
        "processor": _field(cpuinfo, "model name") or _ARM_PARTS.get(part, part and f"Arm, part {part}"),
        "cores": f"{cores}, up to {int(mhz) // 1000} MHz" if mhz.isdecimal() else str(cores),
        "governor": machine.read(f"{_CPU}/scaling_governor"),
        "memory": _memory(machine.read("/proc/meminfo")),
        "system": _field(release, "PRETTY_NAME", "=").strip('"'),
        "kernel": f"{platform.release()}, {platform.machine()}",
        "Python": platform.python_version(),
        "tacshade-edge": installed_version(),
    }
    return {name: escaped(text.replace("|", "/"), _TEXT_MAX) for name, text in facts.items() if text}


def heat(machine: Machine) -> str:
    """Return the processor's temperature and any throttling since boot; empty if neither can be read."""
    zones = [zone for zone in machine.names("/sys/class/thermal", "thermal_zone*") if _is_processor(machine, zone.name)]
    read = [machine.read(f"/sys/class/thermal/{zone.name}/temp") for zone in zones]
    degrees = [int(text) / 1000 for text in read if re.fullmatch(r"\d+", text)]
    said = [f"{max(degrees):.0f} °C"] if degrees else []
    if flags := machine.read(THROTTLED):
        found = [word for bit, word in _SINCE_START.items() if int(flags, 16) >> 16 & bit]
        said.append(f"{' and '.join(found)} since boot" if found else "never throttled since boot")
    return ", ".join(said)


def _is_processor(machine: Machine, zone: str) -> bool:
    return re.search(r"cpu|soc|x86_pkg", machine.read(f"/sys/class/thermal/{zone}/type")) is not None


def _field(text: str, name: str, sign: str = ":") -> str:
    """Return the value of the first line ``name : value``; empty if there is none."""
    found = re.search(rf"^{re.escape(name)}\s*{sign}\s*(.+)$", text, re.MULTILINE)
    return found[1].strip() if found else ""


def _memory(meminfo: str) -> str:
    found = re.search(r"^MemTotal:\s+(\d+) kB", meminfo, re.MULTILINE)
    return f"{int(found[1]) / 2**20:.1f} GiB" if found else ""
