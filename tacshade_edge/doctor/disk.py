"""Checks the disk for calibrations and recordings: has it room, is it writable, is the storage worn out?"""

from __future__ import annotations

import os
from pathlib import Path

from tacshade_edge.doctor.finding import Finding, fault, ok, warning
from tacshade_edge.doctor.machine import Machine

_FULL_BYTES, _LOW_BYTES = 50_000_000, 1_000_000_000
_WORN = 9  # of 10 steps in JEDEC's estimate of an eMMC's used life


def check_disk(folder: Path, machine: Machine) -> tuple[Finding, ...]:
    """Findings on the file system of `folder` (or of its nearest existing parent) and on the storage's wear."""
    existing = next(path for path in (folder, *folder.parents) if os.path.isdir(path))
    status = os.statvfs(existing)
    read_only = bool(status.f_flag & os.ST_RDONLY)
    return (*judge(folder, status.f_bavail * status.f_frsize, read_only), *check_wear(machine))


def judge(folder: Path, free_bytes: int, read_only: bool) -> tuple[Finding, ...]:
    """Findings on what statvfs(2) reports."""
    if read_only:
        fix = (
            "remount the file system read-write; "
            "if the kernel made it read-only, the card may be failing (see sudo dmesg)"
        )
        return (fault("disk", f"{folder} is on a read-only file system", fix),)
    free = f"{folder}: {free_bytes / 1e9:.1f} GB free"
    clear = "delete old recordings and logs (sudo journalctl --vacuum-size=100M; sudo apt clean)"
    if free_bytes < _FULL_BYTES:
        return (fault("disk", f"{free}, too little to write a calibration", clear),)
    if free_bytes < _LOW_BYTES:
        return (warning("disk", f"{free}; recordings will soon fill the disk", clear),)
    return (ok("disk", free),)


def check_wear(machine: Machine) -> tuple[Finding, ...]:
    """A warning for each eMMC that reports being near its end of life; SD cards do not report it."""
    worn = []
    for block in machine.names("/sys/block", "mmcblk*"):
        steps = [int(word, 16) for word in machine.read(f"/sys/block/{block.name}/device/life_time").split()]
        if max(steps, default=0) >= _WORN:
            found = f"{block.name} has used at least {10 * (max(steps) - 1)} % of its life"
            worn.append(warning("disk", found, "back up important files and replace this storage soon"))
    return tuple(worn)
