"""Checks USB: do the streams that the settings request from all cameras fit through the ports that they share?

A camera reserves its share of a bus when its stream begins. One that finds no room fails with "No space left on
device", which does not name the other cameras; so this check adds up the shares beforehand.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from tacshade_edge.doctor.finding import Finding, fault, ok, warning
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.settings import V4l2

_BYTES_PER_PX: Final = {"YUYV": 2.0, "NV12": 1.5, "GREY": 1.0, "MJPG": 0.25}
"""Bytes per pixel; for MJPG the most that pictures of pins and markers take, though a camera may reserve more."""
_SMALL_PX: Final = (320, 240)
_MB: Final = 1e6


@dataclass(frozen=True, slots=True)
class Port:
    """A controller's port with all hubs behind it, which cameras share.

    Attributes
    ----------
    name : str
    speed_mbit : int
        Speed of the camera's own connection, Mbit/s.
    """

    name: str
    speed_mbit: int

    @property
    def most_bytes_s(self) -> float:
        """Limit for all streams in bytes/s; USB 2.0, table 5-5: six 1024-byte packets in each of 8000 microframes/s."""
        if self.speed_mbit < 480:
            return 1023e3  # one packet a millisecond
        return 6 * 1024 * 8000.0 if self.speed_mbit < 5000 else 400e6 * self.speed_mbit / 5000

    @property
    def most_bytes_s_of_one(self) -> float:
        """Limit for one stream in bytes/s: three packets per microframe at 480 Mbit/s."""
        return self.most_bytes_s / 2 if 480 <= self.speed_mbit < 5000 else self.most_bytes_s

    def __str__(self) -> str:
        return f"{self.name} ({self.speed_mbit} Mbit/s)"


def check_usb(cameras: Sequence[V4l2], machine: Machine) -> tuple[Finding, ...]:
    """A finding for each port with configured cameras; none for cameras that are not on USB."""
    on: dict[Port, list[V4l2]] = {}
    for camera in cameras:
        if port := port_of(camera.device, machine):
            on.setdefault(port, []).append(camera)
    return tuple(judge(port, on[port]) for port in on)


def port_of(device: str, machine: Machine) -> Port | None:
    """Return the port that a video node's camera shares with others; None if it is not on USB or missing."""
    node = os.path.basename(os.path.realpath(machine.at(device)))
    above = Path(os.path.realpath(machine.at(f"/sys/class/video4linux/{node}/device")))
    for folder in (above, *above.parents):
        found = re.fullmatch(r"(\d+)-(\d+)[\d.]*", folder.name)
        speed = _text(folder / "speed")
        if found and speed:
            bus, port = found.groups()
            root = next((part for part in folder.parents if part.name == f"usb{bus}"), folder)
            driver = os.path.basename(os.path.realpath(root.parent / "driver"))
            # Only an xHCI controller gives each port its own bandwidth.
            name = f"USB bus {bus}, port {port}" if "xhci" in driver else f"USB bus {bus}"
            return Port(name, int(float(speed)))
    return None


def judge(port: Port, cameras: Sequence[V4l2]) -> Finding:
    """Judge whether the cameras fit through the port; if not, the finding's fix states what would."""
    each = [bytes_s(camera) for camera in cameras]
    load = f"about {sum(each) / _MB:.0f} of {port.most_bytes_s / _MB:.0f} MB/s"
    formats = ", ".join(dict.fromkeys(_format(camera) for camera in cameras))
    count = "1 camera" if len(cameras) == 1 else f"{len(cameras)} cameras"
    found = f"{port}: {count} with {formats}: {load}"
    if fits(port, cameras):
        return ok("usb", found)
    if max(each) > port.most_bytes_s_of_one:
        found += f", but one camera alone gets at most {port.most_bytes_s_of_one / _MB:.0f}"
    # The rate of an uncompressed stream is known to the byte.
    known = [camera for camera in cameras if camera.fourcc != "MJPG"]
    return (warning if fits(port, known) else fault)("usb", found, "; or ".join(_fixes(port, cameras)))


def fits(port: Port, cameras: Sequence[V4l2]) -> bool:
    """Whether all cameras can stream at once."""
    each = [bytes_s(camera) for camera in cameras]
    return sum(each) <= port.most_bytes_s and max(each, default=0) <= port.most_bytes_s_of_one


def bytes_s(camera: V4l2) -> float:
    """Return the data rate of a camera's stream, bytes/s."""
    return camera.width_px * camera.height_px * _BYTES_PER_PX[camera.fourcc] * camera.fps


def _fixes(port: Port, cameras: Sequence[V4l2]) -> list[str]:
    """Return the changes that would make the cameras fit, the least intrusive first."""

    def changed(**values: int | str) -> list[V4l2]:
        return [msgspec.structs.replace(camera, **values) for camera in cameras]

    width, height = _SMALL_PX
    tries = {
        "source.fourcc: MJPG": changed(fourcc="MJPG"),
        f"source.width_px: {width}, height_px: {height}, and calibrate at that size": changed(
            width_px=width, height_px=height
        ),
        f"fourcc: MJPG with {width}x{height}, and calibrate at that size": changed(
            fourcc="MJPG", width_px=width, height_px=height
        ),
    }
    fixes = [
        f"set {words} ({sum(map(bytes_s, other)) / _MB:.0f} MB/s)"
        for words, other in tries.items()
        if fits(port, other) and other != list(cameras)
    ]
    scale = min(port.most_bytes_s / sum(map(bytes_s, cameras)), port.most_bytes_s_of_one / max(map(bytes_s, cameras)))
    fps = math.floor(scale * max(camera.fps for camera in cameras))
    fixes = fixes[:2] + [f"set source.fps to at most {fps}"] * (fps >= 1)
    return [*fixes, "plug some into ports of another controller"] if len(cameras) > 1 else fixes


def _format(camera: V4l2) -> str:
    return f"{camera.fourcc} {camera.width_px}x{camera.height_px} at {camera.fps}/s"


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
