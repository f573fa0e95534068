"""Checks a robot's possible serial ports (permission, other users, FTDI's delay) unopened: opening resets robots."""

from __future__ import annotations

import os
import re

from tacshade_edge.doctor.finding import Finding, fault, ok, warning
from tacshade_edge.doctor.machine import Machine, may_use, permission_fix

_PORT = re.compile(r"tty(USB|ACM|AMA|S|THS)\d+")
_NO_UART = "0"  # /sys/class/tty/ttyS*/type of a port without a chip
_LATENCY_MS = 1
_FTDI_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def check_serial(machine: Machine, device: str | None = "") -> tuple[Finding, ...]:
    """One finding per sound port and one per problem.

    `device` is the robot's port in the settings, "" if there are no settings, None if the settings have no robot.
    """
    if device is None:
        return tuple(_unused(port, machine) for port in _ports(machine)) or (_no_port(),)
    found = _check_ports(machine)
    if not device.startswith("/dev/") or machine.at(device).exists():
        return found
    fix = "plug the robot in, and check which names exist: ls /dev/serial/by-id /dev/tty[AU]*"
    return (fault("serial", f"{device}: no such device, although serial.device names it", fix), *found)


def _ports(machine: Machine) -> list[str]:
    ports = [path.name for path in machine.names("/sys/class/tty", "tty*") if _PORT.fullmatch(path.name)]
    return [port for port in ports if machine.read(f"/sys/class/tty/{port}/type") != _NO_UART]


def _no_port() -> Finding:
    return ok("serial", "found no serial port; only a robot's poses need one")


def _unused(port: str, machine: Machine) -> Finding:
    return ok("serial", f"{_label(port, machine)}: not checked, because the settings name no robot (serial: null)")


def _check_ports(machine: Machine) -> tuple[Finding, ...]:
    return tuple(finding for port in _ports(machine) for finding in _check_port(port, machine)) or (_no_port(),)


def _label(port: str, machine: Machine) -> str:
    device = f"/dev/{port}"
    names = _stable_names(device, machine)
    return f"{device}, best named {names[0]}" if names else device


def _check_port(port: str, machine: Machine) -> tuple[Finding, ...]:
    device = f"/dev/{port}"
    path = machine.at(device)
    label = _label(port, machine)
    if not path.exists():
        return (warning("serial", f"{device}: the kernel lists this port, but /dev does not", "sudo udevadm trigger"),)
    wrong = []
    if not may_use(path):
        wrong.append(warning("serial", f"{label}: no permission", permission_fix(path, "dialout")))
    if _is_console(port, machine):
        fix = (
            f"sudo systemctl disable --now serial-getty@{port}; on a Raspberry Pi, also turn off the login shell in "
            "sudo raspi-config (Interface Options, Serial Port) and reboot. If no robot uses this port, change nothing"
        )
        wrong.append(
            warning("serial", f"{label}: the system's console uses this port and would send text to a robot", fix)
        )
    wrong += [
        warning(
            "serial",
            f"{label}: in use by {process}",
            f"if a robot uses this port, end that program: kill {process.pid}",
        )
        for process in machine.holders(device)
        if process != machine.daemon() and not any(word.endswith("getty") for word in process.words[:1])
    ]
    timer = machine.read(f"/sys/class/tty/{port}/device/latency_timer")
    if timer.isdecimal() and int(timer) > _LATENCY_MS:
        fix = (
            f"echo {_LATENCY_MS} | sudo tee /sys/class/tty/{port}/device/latency_timer; to make this permanent, "
            f"add this line to /etc/udev/rules.d/90-ftdi.rules: {_FTDI_RULE}"
        )
        wrong.append(warning("serial", f"{label}: the port's chip holds bytes back for up to {timer} ms", fix))
    return tuple(wrong) or (ok("serial", f"{label}: the port is free to use"),)


def _stable_names(device: str, machine: Machine) -> list[str]:
    target = os.path.realpath(machine.at(device))
    folders = ("/dev/serial/by-id", "/dev/serial/by-path")
    paths = [path for folder in folders for path in machine.names(folder)]
    return [machine.name_of(path) for path in paths if os.path.realpath(path) == target]


def _is_console(port: str, machine: Machine) -> bool:
    """Whether the kernel or a login uses the port; serial0 is a Pi's name for its first port."""
    consoles = [word.partition("=")[2] for word in machine.read("/proc/cmdline").split() if word.startswith("console=")]
    targets = [os.path.realpath(machine.at(f"/dev/{name.partition(',')[0]}")) for name in consoles]
    if os.path.realpath(machine.at(f"/dev/{port}")) in targets:
        return True
    return any(
        process.words[0].endswith("getty") and any(word in (port, f"/dev/{port}") for word in process.words[1:])
        for process in machine.processes()
    )
