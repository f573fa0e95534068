"""Checks the board itself: power, heat and governor, clocks, disk;
and the facts that name it in a report.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import time
from pathlib import Path

from tacshade_edge.doctor import Finding, Findings, fault, ok, warning
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.quoting import escaped
from tacshade_edge.version import installed_version

# Bits of get_throttled for the present state; the same bits 16 higher are for the time since boot.
_UNDER_VOLTAGE, _CAPPED, _SLOWED, _HOT = 1, 2, 4, 8
# Their `powersave` follows the load; with others it means the lowest frequency.
_OWN_SCALING = ("intel_pstate", "amd-pstate-epp")
# adjtimex(2): the clock is not synchronised, whoever should do it.
_TIME_ERROR = 5
# struct timex has at most 208; all zero, it reads the state and changes nothing.
_TIMEX_BYTES = 512
_DAY_S = 86400
# A calibration with fitted networks has a few MB and is written beside the old one; a recording
# fills a GB within minutes.
_FULL_BYTES, _LOW_BYTES = 50_000_000, 1_000_000_000
THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
_CPU = "/sys/devices/system/cpu/cpu0/cpufreq"
MODEL = "/proc/device-tree/model"
# Arm's "CPU part" in /proc/cpuinfo for the boards that the documents name.
_ARM_PARTS = {"0xd03": "Cortex-A53", "0xd08": "Cortex-A72", "0xd0b": "Cortex-A76"}
# Words for reports; the findings above say what to do.
_SINCE_START = {
    _UNDER_VOLTAGE: "under-voltage",
    _CAPPED: "capped",
    _SLOWED: "throttled",
    _HOT: "hot",
}
_TEXT_MAX = 80


def check_board(machine: Machine) -> Findings:
    """Findings on what a Raspberry Pi's firmware reports and on the kernel's frequency scaling."""
    found = []
    text = machine.read(THROTTLED)
    flags = int(text, 16) if text else 0
    for bits, what, fix in (
        (
            _UNDER_VOLTAGE,
            "under-voltage",
            "use the board's own power supply and a short thick cable",
        ),
        (
            _CAPPED | _SLOWED | _HOT,
            "slowed down",
            "cool it (heat sink, fan, open case) and check its power supply",
        ),
    ):
        if flags & bits:
            found.append(warning("board", f"{what} now; frames will be late or lost", fix))
        # Power that fails only under load is seen afterwards, not while doctor looks.
        elif flags >> 16 & bits:
            found.append(warning("board", f"{what} at some time since boot, but not now", fix))
    if text and not found:
        found.append(ok("board", "power and temperature have been fine since boot"))
    scaled_by, governor = (
        machine.read(f"{_CPU}/scaling_{name}") for name in ("driver", "governor")
    )
    if governor == "powersave" and scaled_by not in _OWN_SCALING:
        fix = "echo ondemand | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
        found.append(
            warning("board", "the powersave governor keeps the processor at its lowest speed", fix)
        )
    return tuple(found)


def check_clock() -> Findings:
    return (judge_clock(time.time(), Path(__file__).stat().st_mtime, synced=synchronised()),)


def synchronised() -> bool | None:
    """Whether any program synchronises the kernel's clock, with or without systemd;
    None if the kernel reports none.
    """
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    return None if state < 0 else state != _TIME_ERROR


def judge_clock(now_s: float, installed_s: float, *, synced: bool | None) -> Finding:
    """Judge the wall clock's time and its synchronisation."""
    today = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(now_s))
    keep = (
        "connect to a network and run: sudo timedatectl set-ntp true (without systemd: "
        "install chrony)"
    )
    # A day, because files may be installed with times of another zone.
    if now_s < installed_s - _DAY_S:
        since = time.strftime("%Y-%m-%d", time.gmtime(installed_s))
        found = (
            f"the date is {today}, but this program was installed on {since}, so times and file "
            "names will be wrong"
        )
        keep += "; a board without a battery-backed clock loses the time when it is switched off"
        return fault("clock", found, keep)
    if synced is False:
        wrong = "times in messages and recordings may be wrong; measurements are not affected"
        return warning("clock", f"{today}, not synchronised: {wrong}", keep)
    known = (
        "synchronised" if synced else "the kernel does not report whether the clock is synchronised"
    )
    return ok("clock", f"{today}, {known}")


def check_disk(folder: Path) -> Findings:
    """Findings on the file system of `folder`, or of its nearest existing parent."""
    # The folder may be made by the first start of the daemon.
    existing = next(path for path in (folder, *folder.parents) if os.path.isdir(path))
    status = os.statvfs(existing)
    read_only = bool(status.f_flag & os.ST_RDONLY)
    return (judge_disk(folder, status.f_bavail * status.f_frsize, read_only=read_only),)


def judge_disk(folder: Path, free_bytes: int, *, read_only: bool) -> Finding:
    if read_only:
        fix = (
            "remount it read-write; if the kernel made it read-only, "
            "the card may be failing (see sudo dmesg)"
        )
        return fault("disk", f"{folder} is on a read-only file system", fix)
    free = f"{folder}: {free_bytes / 1e9:.1f} GB free"
    clear = "delete old recordings and logs (sudo journalctl --vacuum-size=100M; sudo apt clean)"
    if free_bytes < _FULL_BYTES:
        return fault("disk", f"{free}, too little to write a calibration", clear)
    if free_bytes < _LOW_BYTES:
        return warning("disk", f"{free}; recordings will soon fill the disk", clear)
    return ok("disk", free)


def board_facts(machine: Machine) -> dict[str, str]:
    """Return board, processor and software by name, without what cannot be read."""
    cpuinfo, release = machine.read("/proc/cpuinfo"), machine.read("/etc/os-release")
    part = _field(cpuinfo, "CPU part")
    cores = len(os.sched_getaffinity(0))
    mhz = machine.read(f"{_CPU}/cpuinfo_max_freq")
    memory_kb = _field(machine.read("/proc/meminfo"), "MemTotal").removesuffix(" kB")
    facts = {
        "board": machine.read(MODEL).rstrip("\0") or f"{platform.machine()} machine",
        "processor": _field(cpuinfo, "model name")
        or _ARM_PARTS.get(part, part and f"Arm, part {part}"),
        "cores": f"{cores}, up to {int(mhz) // 1000} MHz" if mhz.isdecimal() else str(cores),
        "governor": machine.read(f"{_CPU}/scaling_governor"),
        "memory": f"{int(memory_kb) / 2**20:.1f} GiB" if memory_kb else "",
        "system": _field(release, "PRETTY_NAME", "=").strip('"'),
        "kernel": f"{platform.release()}, {platform.machine()}",
        "Python": platform.python_version(),
        "tacshade-edge": installed_version(),
    }
    return {
        name: escaped(text.replace("|", "/"), _TEXT_MAX) for name, text in facts.items() if text
    }


def heat(machine: Machine) -> str:
    """Return the processor's temperature and any throttling since boot;
    empty if neither can be read.
    """
    zones = [
        f"/sys/class/thermal/{zone.name}"
        for zone in machine.names("/sys/class/thermal", "thermal_zone*")
    ]
    read = [
        machine.read(f"{zone}/temp")
        for zone in zones
        if re.search("cpu|soc|x86_pkg", machine.read(f"{zone}/type"))
    ]
    degrees = [int(text) / 1000 for text in read if re.fullmatch(r"\d+", text)]
    said = [f"{max(degrees):.0f} °C"] if degrees else []
    if flags := machine.read(THROTTLED):
        found = [word for bit, word in _SINCE_START.items() if int(flags, 16) >> 16 & bit]
        said.append(f"{' and '.join(found)} since boot" if found else "never throttled since boot")
    return ", ".join(said)


def _field(text: str, name: str, sign: str = ":") -> str:
    """Return the value of the first line ``name : value``; empty if there is none."""
    found = re.search(rf"^{re.escape(name)}\s*{sign}\s*(.+)$", text, re.MULTILINE)
    return found[1].strip() if found else ""
