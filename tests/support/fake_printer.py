"""A 3-D printer on a pty that answers as its firmware does. Its head presses the simulated sensor through a file.

It has the faults of real printers: answers that arrive byte by byte with temperatures in between, a board that restarts
at the first command, damaged lines, lost answers, lost steps, a halt, another program's limits.
"""

from __future__ import annotations

import contextlib
import math
import os
import pty
import re
import select
import threading
import tty
from dataclasses import dataclass, field
from functools import reduce
from operator import xor
from pathlib import Path
from types import TracebackType

from tools.testbed.patience import wait_until

_WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d*)?)")
_BOOT_S = 0.3


@dataclass(frozen=True)
class Dialect:
    """What a firmware answers, as its source or documentation has it.

    `about` and `position` are whole answers to M115 and M114, with their ok; `unhomed` is that to a move before homing,
    empty if it moves. If it `boots`, opening the port restarts the board; if `m84_releases`, M84 with any parameter
    switches the motors off and forgets homing.
    """

    name: str
    about: str
    position: str = "X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count X:{x:.0f} Y:{y:.0f} Z:{z:.0f}\nok"
    boots: bool = False
    m84_releases: bool = True
    unhomed: str = ""


MARLIN = Dialect(
    "Marlin",
    "FIRMWARE_NAME:Marlin 2.1.2 (Jan  1 2024 12:00:00) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin "
    "PROTOCOL_VERSION:1.0 MACHINE_TYPE:fake EXTRUDER_COUNT:1\nCap:EEPROM:1\nCap:AUTOREPORT_TEMP:1\nok",
    boots=True,
    m84_releases=False,
)
PRUSA = Dialect(
    "Prusa",
    "FIRMWARE_NAME:Prusa-Firmware 3.13.3 based on Marlin FIRMWARE_URL:https://github.com/prusa3d/Prusa-Firmware "
    "PROTOCOL_VERSION:1.0 MACHINE_TYPE:Prusa i3 MK3S EXTRUDER_COUNT:1\nok",
    "X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count X: {x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00\nok",
    boots=True,
    m84_releases=False,
)
PRUSA_BUDDY = Dialect(
    "Prusa-Buddy",
    "FIRMWARE_NAME:Prusa-Firmware-Buddy 5.1.2 (Github) SOURCE_CODE_URL:https://github.com/prusa3d/Prusa-Firmware-Buddy "
    "PROTOCOL_VERSION:1.0 MACHINE_TYPE:Prusa-XL EXTRUDER_COUNT:1\nCap:BINARY_FILE_TRANSFER:0\nok",
    "X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count A:{x:.0f} B:{y:.0f} Z:{z:.0f}\nok",
    m84_releases=False,
)
KLIPPER = Dialect(
    "Klipper",
    "ok FIRMWARE_NAME:Klipper FIRMWARE_VERSION:v0.12.0-1-g0",
    "X:{x:.3f} Y:{y:.3f} Z:{z:.3f} E:0.000\nok",
    unhomed="!! Must home axis first: {x:.3f} {y:.3f} {z:.3f} [0.000]\nok",
)
REPRAPFIRMWARE = Dialect(
    "RepRapFirmware",
    "FIRMWARE_NAME: RepRapFirmware for Duet 2 WiFi/Ethernet FIRMWARE_VERSION: 3.5.1 ELECTRONICS: Duet WiFi 1.02 "
    "FIRMWARE_DATE: 2024-04-19\nok",
    "X:{x:.3f} Y:{y:.3f} Z:{z:.3f} E:0.000 E0:0.0 Count 800 1600 2000 Machine {x:.3f} {y:.3f} {z:.3f} "
    "Bed comp 0.000\nok",
    unhomed="Error: G0/G1: insufficient axes homed\nok",
)
SMOOTHIEWARE = Dialect(
    "Smoothieware",
    "FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//smoothieware.org, FIRMWARE_VERSION:edge-9d5a, "
    "PROTOCOL_VERSION:1.0, X-FIRMWARE_BUILD_DATE:Jan 1 2024, X-AXES:3\nok",
    "ok C: X:{x:.4f} Y:{y:.4f} Z:{z:.4f} E:0.0000",
)
ONE_DECIMAL = Dialect("one decimal", "FIRMWARE_NAME:Own\nok", "X:{x:.1f} Y:{y:.1f} Z:{z:.1f} E:0.0\nok")


@dataclass
class Mounted:
    """The mounted indenter: its row of the file, and how much lower than the first indenter it ends."""

    indenter: str = "ball"
    radius_mm: str = "6"
    lower_mm: float = 0.0


@dataclass
class Sensor:
    """The true place of the simulated sensor."""

    x_mm: float = 101.7
    y_mm: float = 98.9
    tip_z_mm: float = 61.23
    yaw_deg: float = 33.0
    skin_radius_mm: float = 20.0


@dataclass
class Faults:
    """Faults, each of which happens once: at a number of received commands, or below a height of the head.

    The line that arrives with a flipped bit, the command whose answer is lost, that fails, that restarts the printer;
    the heights below which it halts and below which it moves 2 mm less than it reports; and above which it does not
    move, without a report.
    """

    damaged_line: int = 0
    lost_answer: int = 0
    error: int = 0
    restart: int = 0
    halts_below_mm: float = -math.inf
    loses_steps_below_mm: float = -math.inf
    highest_mm: float = math.inf


@dataclass
class FakePrinter:
    """Serves at `port` until the end of its ``with``.

    `hand` is the file that presses the simulated sensor, replaced whenever the head has moved; `pace` the seconds that
    each second of motion takes, `moves` every place of the head so far, mm.
    """

    hand: Path
    sensor: Sensor = field(default_factory=Sensor)
    faults: Faults = field(default_factory=Faults)
    mounted: Mounted = field(default_factory=Mounted)
    dialect: Dialect = MARLIN
    is_homed: bool = False
    pace: float = 0.0
    port: str = ""
    moves: list[tuple[float, float, float]] = field(default_factory=list)
    heard: list[str] = field(default_factory=list)
    halted: bool = False

    def __enter__(self) -> FakePrinter:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave  # kept, so that a host which closes it does not end the line
        self._place = [0.0, 0.0, 0.0]
        self._last = 0
        self._motion_s = 0.0
        self._booted = not self.dialect.boots
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="printer", daemon=True)
        self.press()
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._ending.set()
        self._thread.join()
        with contextlib.suppress(OSError):
            os.close(self._slave)
            os.close(self._master)

    def pull_the_cable(self) -> None:
        """Make the host's end fail from now on."""
        os.close(self._slave)
        os.close(self._master)

    def mount(self, mounted: Mounted) -> None:
        """Put another indenter into the head."""
        self.mounted = mounted
        self.press()

    def wait_until_below(self, z_mm: float) -> None:
        """Wait until a command sends the head lower, after it was homed and at its start."""
        wait_until(lambda: self.is_homed and len(self.moves) > 40 and self.moves[-1][2] < z_mm, 60, f"z under {z_mm}")

    def press(self) -> None:
        """Write the press of the sensor at the head's true place."""
        x, y, z = self._place
        if z < self.faults.loses_steps_below_mm:
            z += 2.0
        angle = -math.radians(self.sensor.yaw_deg)
        dx, dy = x - self.sensor.x_mm, y - self.sensor.y_mm
        u, v = dx * math.cos(angle) - dy * math.sin(angle), dx * math.sin(angle) + dy * math.cos(angle)
        r = self.sensor.skin_radius_mm
        row = ""
        if self.is_homed and math.hypot(u, v) < 0.9 * r:
            depth = math.sqrt(r * r - u * u - v * v) - (z - self.mounted.lower_mm - self.sensor.tip_z_mm + r)
            if depth > -8:  # wide things touch beside where their lowest point is
                yaw = "" if self.mounted.indenter == "ball" else f"{-self.sensor.yaw_deg}"
                row = f"{self.mounted.indenter},{self.mounted.radius_mm},{depth:.4f},{u:.4f},{v:.4f},{yaw}\n"
        beside = self.hand.with_suffix(".part")
        beside.write_text("indenter,radius_mm,depth_mm,x_mm,y_mm,yaw_deg\n" + row)
        os.replace(beside, self.hand)

    def _serve(self) -> None:
        buffer = b""
        while not self._ending.is_set():
            try:
                if not select.select([self._master], [], [], 0.05)[0]:
                    continue
                buffer += os.read(self._master, 4096)
                while b"\n" in buffer:
                    line, _, buffer = buffer.partition(b"\n")
                    if not self._booted:
                        self._boot()
                        buffer = b""
                        continue
                    self._take(line)
            except OSError:
                return  # the cable was pulled

    def _boot(self) -> None:
        self._ending.wait(_BOOT_S)
        self._booted = True
        self._last = 0
        self._place = [0.0, 0.0, 0.0]
        self._say("start", "echo: External Reset", self.dialect.name, "echo:SD card ok")

    def _take(self, line: bytes) -> None:
        if not line.strip() or self.halted:
            return
        if line.strip() == b"M112":
            self.halted = True
            self._say("Error:Printer halted. kill() called!")
            return
        text, _, checksum = line.strip().rpartition(b"*")
        number = int(re.match(rb"N(-?\d+) ", text)[1])  # type: ignore[index]
        command = text.decode().partition(" ")[2]
        damaged = self.faults.damaged_line == len(self.heard) + 1
        if damaged:
            self.faults.damaged_line = 0
        if damaged or reduce(xor, text, 0) != int(checksum):
            self._say(f"Error:checksum mismatch, Last Line: {self._last}", f"Resend: {self._last + 1}", "ok")
            return
        if not command.startswith("M110") and number != self._last + 1:
            self._say(f"Error:Line Number is not Last Line Number+1, Last Line: {self._last}")
            self._say(f"Resend: {self._last + 1}", "ok")
            return
        self._last = number
        self.heard.append(command)
        self._obey(command)

    def _obey(self, command: str) -> None:
        count = len(self.heard)
        if count == self.faults.restart:
            self._boot()
            return
        if count == self.faults.error:
            self._say("Error:MAXTEMP triggered, system stopped!")
            return
        x, y, z = self._place
        answer = "ok"
        match command.split()[0]:
            case "G28":
                self._say("echo:busy: processing")
                self._wait(8.0)
                self._place, self.is_homed = [0.0, 0.0, 0.0], True
                self._say("X:0.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0")
            case "G1" if self.dialect.unhomed and not self.is_homed:
                answer = self.dialect.unhomed.format(x=x, y=y, z=z)
            case "G1":
                self._move(dict(_WORD.findall(command)))
            case "M400":
                self._wait(self._motion_s)
                self._motion_s = 0.0
            case "M114":
                answer = self.dialect.position.format(x=x, y=y, z=z)
            case "M115":
                answer = self.dialect.about
            case "M84" if self.dialect.m84_releases:
                self.is_homed = False
        if self.halted:
            return
        if count % 5 == 0:
            self._say(" T:21.44 /0.00 B:21.20 /0.00 @:0 B@:0")
        if count != self.faults.lost_answer:
            self._say(*answer.splitlines())

    def _move(self, words: dict[str, str]) -> None:
        to = [float(words[axis]) for axis in "XYZ"]
        to[2] = min(to[2], self.faults.highest_mm)
        self._motion_s += math.dist(to, self._place) / (float(words["F"]) / 60)
        self._place = to
        self.moves.append((to[0], to[1], to[2]))
        self.press()
        if to[2] < self.faults.halts_below_mm:
            self.halted = True
            self._say("Error:Printer halted. kill() called!")

    def _wait(self, seconds: float) -> None:
        self._ending.wait(self.pace * seconds)

    def _say(self, *lines: str) -> None:
        """Send lines byte by byte, as a slow line delivers them."""
        for byte in "".join(f"{line}\n" for line in lines).encode():
            os.write(self._master, bytes([byte]))
