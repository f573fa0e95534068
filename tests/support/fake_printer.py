"""A 3-D printer on a pty that answers like Marlin. Its head presses the simulated sensor through a file.

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

    Attributes
    ----------
    damaged_line : int
        Number of the line that arrives with a flipped bit.
    lost_answer, error, restart : int
        Number of the command whose answer is lost; that fails; that the printer answers by restarting.
    halts_below_mm, loses_steps_below_mm : float
        Heights below which the printer halts; below which the head moves 2 mm less than it reports.
    highest_mm : float
        Height above which the head does not move, without a report.
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
    """Serves until the end of its ``with``.

    Attributes
    ----------
    hand : Path
        The file that presses the simulated sensor; replaced whenever the head has moved.
    pace : float
        Seconds that each second of motion takes.
    port : str
        The host's port.
    moves : list of (x, y, z)
        Every place of the head so far, mm.
    """

    hand: Path
    sensor: Sensor = field(default_factory=Sensor)
    faults: Faults = field(default_factory=Faults)
    mounted: Mounted = field(default_factory=Mounted)
    firmware: str = "Marlin 2.1.2"
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
        self._booted = False
        self._is_homed = False
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
        wait_until(lambda: self._is_homed and len(self.moves) > 40 and self.moves[-1][2] < z_mm, 60, f"z under {z_mm}")

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
        if self._is_homed and math.hypot(u, v) < 0.9 * r:
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
        self._say("start", "echo: External Reset", f"{self.firmware}", "echo:SD card ok")

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
        words = dict(_WORD.findall(command))
        match command.split()[0]:
            case "G28":
                self._say("echo:busy: processing")
                self._wait(8.0)
                self._place, self._is_homed = [0.0, 0.0, 0.0], True
                self._say("X:0.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0")
            case "G1":
                self._move(words)
            case "M400":
                self._wait(self._motion_s)
                self._motion_s = 0.0
            case "M114":
                x, y, z = self._place
                self._say(f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count X:{80 * x:.0f} Y:{80 * y:.0f} Z:{400 * z:.0f}")
            case "M115":
                self._say(f"FIRMWARE_NAME:{self.firmware} SOURCE_CODE_URL:github.com MACHINE_TYPE:fake")
        if self.halted:
            return
        if count % 5 == 0:
            self._say(" T:21.44 /0.00 B:21.20 /0.00 @:0 B@:0")
        if count != self.faults.lost_answer:
            self._say("ok")

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
