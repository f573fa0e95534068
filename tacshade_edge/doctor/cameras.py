"""Lists a machine's cameras by the names that survive replugging."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

from tacshade_edge.devices.camera.rpicam import PROGRAM
from tacshade_edge.doctor.machine import Machine

# Best first. This project's udev rules add the names by USB port in /dev/tacshade.
_NAMES = ("/dev/v4l/by-id", "/dev/tacshade", "/dev/v4l/by-path")
# A Raspberry Pi's own nodes: its CSI receivers, and those that every Pi has with or without a camera.
CSI_RECEIVERS = ("unicam", "rp1-cfe")
_OWN_NODES = (*CSI_RECEIVERS, "bcm2835-isp", "bcm2835-codec", "pispbe", "rpi-hevc-dec", "rpivid")
CSI_FIX = (
    "a Raspberry Pi's own (CSI, ribbon cable) camera is read through rpicam-vid: set source: {kind: rpicam, camera: 0}"
)
_LIST_S = 2.5


def csi_cameras() -> dict[int, str]:
    """Return number and name of each CSI camera that ``rpicam-vid --list-cameras`` lists; none without the program."""
    try:
        words = (PROGRAM, "--list-cameras")
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", timeout=_LIST_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return {}
    found = re.findall(r"^(\d+) : (.*?)(?: \(/.*\))?$", done.stdout, re.MULTILINE)
    return {int(number): name for number, name in found}


def card_name(device: str, machine: Machine) -> str:
    """Return the driver's name for the node; empty if the kernel has no such node."""
    node = os.path.basename(os.path.realpath(machine.at(device)))
    return machine.read(f"/sys/class/video4linux/{node}/name")


def is_csi(device: str, machine: Machine) -> bool:
    """Whether the node is one of a Raspberry Pi's own and no USB camera's."""
    return card_name(device, machine).startswith(_OWN_NODES)


def has_csi_receiver(machine: Machine) -> bool:
    """Whether the machine has a CSI receiver's node."""
    return any(card_name(f"/dev/{node.name}", machine).startswith(CSI_RECEIVERS) for node in _nodes(machine))


def stable_name(device: str, machine: Machine) -> str:
    """Return the node's name that survives replugging; empty if there is none."""
    target = os.path.realpath(machine.at(device))
    for folder in _NAMES:
        for path in machine.names(folder):
            if os.path.realpath(path) == target:
                return machine.name_of(path)
    return ""


def found_cameras(machine: Machine) -> list[str]:
    """Return a device name for each camera, the stable one if it has one."""
    names = []
    for node in _nodes(machine):
        device = f"/dev/{node.name}"
        # A USB camera's nodes with higher indices carry metadata.
        first = machine.read(f"/sys/class/video4linux/{node.name}/index") in ("", "0")
        if first and not is_csi(device, machine):
            names.append(stable_name(device, machine) or device)
    return names


def _nodes(machine: Machine) -> list[Path]:
    return machine.names("/dev", "video[0-9]*")
