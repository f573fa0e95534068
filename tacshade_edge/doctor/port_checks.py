"""Checks ports: can the streams of all cameras share a USB port,
and is a robot's serial port free to use?

A camera without room on its bus fails with "No space left on device", which names no other camera;
so this adds up the shares. A serial port is looked at unopened: opening resets robots.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tacshade_edge.doctor import Finding, Findings, fault, ok, warning
from tacshade_edge.doctor.machine import Machine, may_use, permission_fix
from tacshade_edge.quoting import counted
from tacshade_edge.settings import V4l2

_PORT = re.compile(r"tty(USB|ACM|AMA|S|THS)\d+")
# /sys/class/tty/ttyS*/type of a port without a chip: PCs list four ports, most of them empty.
_NO_UART = "0"
# The chips of FTDI wait 16 ms for more bytes by default: longer than a frame, and it spoils the
# clock exchange with the robot.
_LATENCY_MS = 1
_FTDI_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
_BYTES_PER_PX: Final = {"YUYV": 2.0, "NV12": 1.5, "GREY": 1.0, "MJPG": 0.25}
"""Bytes per pixel; for MJPG the most that pictures of pins and markers take,
though a camera may reserve more.
"""
_MB: Final = 1e6
_HIGH_MBIT, _SUPER_MBIT = 480, 5000  # of USB 2.0 and of USB 3.0


def check_serial(machine: Machine, device: str | None = "") -> Findings:
    """One finding per sound port and problem; `device` is the robot's, None if there is none,
    "" if unknown.
    """
    # ttyS* of a PC, ttyAMA and ttyTHS of boards, ttyUSB and ttyACM of adapters: consoles are tty1
    # and so on.
    listed = [
        path.name for path in machine.names("/sys/class/tty", "tty*") if _PORT.fullmatch(path.name)
    ]
    found: list[Finding] = []
    for port in listed:
        if machine.read(f"/sys/class/tty/{port}/type") == _NO_UART:
            continue
        if device is None:
            unused = (
                f"{_label(port, machine)}: not checked, because the settings name no robot "
                "(serial: null)"
            )
            found.append(ok("serial", unused))
        else:
            found += _check_port(port, machine)
    found = found or [ok("serial", "found no serial port; only a robot's poses need one")]
    # A name such as socket://HOST:PORT is no device.
    if device is None or not device.startswith("/dev/") or machine.at(device).exists():
        return tuple(found)
    fix = "plug the robot in, and check which names exist: ls /dev/serial/by-id /dev/tty[AU]*"
    return (
        fault("serial", f"{device}: no such device, although serial.device names it", fix),
        *found,
    )


def _label(port: str, machine: Machine) -> str:
    target = os.path.realpath(machine.at(f"/dev/{port}"))
    paths = [
        path for folder in ("by-id", "by-path") for path in machine.names(f"/dev/serial/{folder}")
    ]
    names = [machine.name_of(path) for path in paths if os.path.realpath(path) == target]
    return f"/dev/{port}, best named {names[0]}" if names else f"/dev/{port}"


def _check_port(port: str, machine: Machine) -> Findings:
    device = f"/dev/{port}"
    path = machine.at(device)
    label = _label(port, machine)
    if not path.exists():
        return (
            warning(
                "serial",
                f"{device}: the kernel lists this port, but /dev does not",
                "sudo udevadm trigger",
            ),
        )
    wrong = []
    if not may_use(path):
        wrong.append(warning("serial", f"{label}: no permission", permission_fix(path, "dialout")))
    if _is_console(port, machine):
        fix = (
            f"if a robot uses this port: sudo systemctl disable --now serial-getty@{port}; "
            "on a Raspberry Pi, also turn"
        )
        fix += (
            " off the login shell in sudo raspi-config (Interface Options, Serial Port) and reboot"
        )
        found = f"{label}: the system's console uses this port and would send text to a robot"
        wrong.append(warning("serial", found, fix))
    for process in machine.holders(device):
        if process != machine.daemon() and not any(
            word.endswith("getty") for word in process.words[:1]
        ):
            fix = f"if a robot uses this port, end that program: kill {process.pid}"
            wrong.append(warning("serial", f"{label}: in use by {process}", fix))
    timer = machine.read(f"/sys/class/tty/{port}/device/latency_timer")
    if timer.isdecimal() and int(timer) > _LATENCY_MS:
        fix = (
            f"echo {_LATENCY_MS} | sudo tee /sys/class/tty/{port}/device/latency_timer; to make "
            "this permanent, "
        )
        fix += f"add this line to /etc/udev/rules.d/90-ftdi.rules: {_FTDI_RULE}"
        wrong.append(
            warning(
                "serial", f"{label}: the port's chip holds bytes back for up to {timer} ms", fix
            )
        )
    return tuple(wrong) or (ok("serial", f"{label}: the port is free to use"),)


def _is_console(port: str, machine: Machine) -> bool:
    """Whether the kernel or a login uses the port; serial0 is a Pi's name for its first port."""
    # The kernel writes its messages there from the start, whoever logs in later.
    consoles = re.findall(r"(?:^|\s)console=([^\s,]+)", machine.read("/proc/cmdline"))
    if os.path.realpath(machine.at(f"/dev/{port}")) in [
        os.path.realpath(machine.at(f"/dev/{c}")) for c in consoles
    ]:
        return True
    return any(
        process.words[0].endswith("getty")
        and any(word in (port, f"/dev/{port}") for word in process.words[1:])
        for process in machine.processes()
    )


@dataclass(frozen=True, slots=True)
class Port:
    """A controller's port with all hubs behind it, which cameras share."""

    name: str
    speed_mbit: int  # of the camera's own connection, Mbit/s

    @property
    def most_bytes_s(self) -> float:
        """Limit for all streams in bytes/s; USB 2.0, table 5-5:
        six 1024-byte packets in each of 8000 microframes/s.
        """
        # Full speed: one isochronous packet of 1023 bytes a millisecond.
        if self.speed_mbit < _HIGH_MBIT:
            return 1023e3  # one packet a millisecond
        if self.speed_mbit < _SUPER_MBIT:
            return 6 * 1024 * 8000.0
        # What is left of 5 Gbit/s after its line code (8b/10b) and its protocol.
        return 400e6 * self.speed_mbit / _SUPER_MBIT

    @property
    def most_bytes_s_of_one(self) -> float:
        """Limit for one stream in bytes/s: three packets per microframe at 480 Mbit/s."""
        halves = _HIGH_MBIT <= self.speed_mbit < _SUPER_MBIT
        return self.most_bytes_s / 2 if halves else self.most_bytes_s

    def __str__(self) -> str:
        return f"{self.name} ({self.speed_mbit} Mbit/s)"


def check_usb(cameras: Sequence[V4l2], machine: Machine) -> Findings:
    """A finding for each port with configured cameras; none for cameras that are not on USB."""
    on: dict[Port, list[V4l2]] = {}
    for camera in cameras:
        if port := port_of(camera.device, machine):
            on.setdefault(port, []).append(camera)
    return tuple(judge_usb(port, on[port]) for port in on)


def port_of(device: str, machine: Machine) -> Port | None:
    """Return the port that a video node's camera shares with others;
    None if it is not on USB or missing.
    """
    node = os.path.basename(os.path.realpath(machine.at(device)))
    above = Path(os.path.realpath(machine.at(f"/sys/class/video4linux/{node}/device")))
    for folder in (above, *above.parents):
        # Folders of USB devices are named BUS-PORT.PORT..., the port of the controller first.
        found = re.fullmatch(r"(\d+)-(\d+)[\d.]*", folder.name)
        if found and (speed := machine.read(machine.name_of(folder / "speed"))):
            bus, port = found.groups()
            root = next((part for part in folder.parents if part.name == f"usb{bus}"), folder)
            driver = os.path.basename(os.path.realpath(root.parent / "driver"))
            # Only an xHCI controller gives each port its own bandwidth.
            name = f"USB bus {bus}, port {port}" if "xhci" in driver else f"USB bus {bus}"
            return Port(name, int(float(speed)))
    return None


def judge_usb(port: Port, cameras: Sequence[V4l2]) -> Finding:
    """Judge whether the cameras fit through the port."""
    each = [bytes_s(camera) for camera in cameras]
    formats = ", ".join(
        dict.fromkeys(f"{c.fourcc} {c.width_px}x{c.height_px} at {c.fps}/s" for c in cameras)
    )
    found = f"{port}: {counted(len(cameras), 'camera')} with {formats}: "
    found += f"about {sum(each) / _MB:.0f} of {port.most_bytes_s / _MB:.0f} MB/s"
    if fits(port, cameras):
        return ok("usb", found)
    if max(each) > port.most_bytes_s_of_one:
        found += f", but one camera alone gets at most {port.most_bytes_s_of_one / _MB:.0f}"
    scale = min(port.most_bytes_s / sum(each), port.most_bytes_s_of_one / max(each))
    slower = int(scale * max(camera.fps for camera in cameras))
    fix = f"set source.fourcc: MJPG, or source.fps to at most {slower}, or a smaller size"
    # The rate of an uncompressed stream is known to the byte.
    # How small JPEGs are depends on the picture: only what is certain is a fault.
    known = [camera for camera in cameras if camera.fourcc != "MJPG"]
    return (warning if fits(port, known) else fault)(
        "usb", found, f"{fix}; or plug some into another controller's ports"
    )


def fits(port: Port, cameras: Sequence[V4l2]) -> bool:
    each = [bytes_s(camera) for camera in cameras]
    return sum(each) <= port.most_bytes_s and max(each, default=0) <= port.most_bytes_s_of_one


def bytes_s(camera: V4l2) -> float:
    """Bytes per second of a camera with a stated size."""
    assert camera.width_px is not None
    assert camera.height_px is not None
    return camera.width_px * camera.height_px * _BYTES_PER_PX[camera.fourcc] * camera.fps
