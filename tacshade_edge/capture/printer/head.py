"""The printer's head behind its serial line: one command at a time, in short parts, its position checked after each."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from tacshade_edge.capture.terminal import InputEnded, Terminal
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.errors import DeviceError
from tacshade_edge.protocol import gcode
from tacshade_edge.quoting import quoted
from tacshade_edge.settings.printer_file import PrinterFile
from tacshade_edge.types import F64


class SafetyStop(DeviceError):
    """Something is not as expected, so nothing may move any further."""


class Stopped(Exception):
    """A person or a signal stopped the machine."""


class KeypressStop:
    """A check for keypresses at a terminal.

    Parameters
    ----------
    terminal : Terminal
        Inside its `keys` context while anything moves.
    """

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def check(self) -> None:
        """Raise Stopped if a key was pressed or the terminal has closed."""
        try:
            pressed = self._terminal.line() is not None
        except InputEnded:
            raise Stopped("the terminal has closed") from None
        if pressed:
            raise Stopped("a key was pressed")


# A board that resets when its port opens answers only after its boot loader, which takes seconds.
_GREETINGS, _GREETING_S = 6, 3.0
_QUIET_S = 0.5
ANSWER_S = 10.0
"""Time limit in s for the answer to a command that moves the head for at most half a second."""

# Longest wait for a printer that keeps reporting that it is busy.
_BUSY_MOST_S = 180.0
_STOP_S = 1.0


class PrinterLine:
    """The serial line to one printer."""

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self._exchange = gcode.Exchange()
        self.firmware = "unknown firmware"

    @property
    def has_restarted(self) -> bool:
        """Whether the printer has restarted since `connect`, as many boards do then: it is no longer homed."""
        return self._exchange.has_restarted

    def connect(self) -> None:
        """Open the port, wait until the printer answers, and count lines from 0. Raises ConfigError, DeviceError."""
        self._port.open()
        self._write(b"\n")  # ends a line that an earlier program may have left half sent
        if not any(self._greeted() for _ in range(_GREETINGS)):
            found = f"got no reply within {_GREETINGS * _GREETING_S:.0f} s"
            raise DeviceError(
                f"printer {self._port.device}: {found}, expected 'ok' from Marlin or Klipper; is the baud rate right?"
            )
        self._until_quiet()
        self._write(self._exchange.begin_anew())
        self._wait(ANSWER_S, gcode.first_number(0), None)
        names = map(gcode.firmware_name, self.do(gcode.FIRMWARE))
        self.firmware = next(filter(None, names), self.firmware)

    def do(
        self, command: str, limit_s: float = ANSWER_S, while_waiting: Callable[[], None] | None = None
    ) -> tuple[str, ...]:
        """Send a command and wait for its answer.

        Parameters
        ----------
        command : str
        limit_s : float
            Longest time without an answer or a report that the printer is busy.
        while_waiting : callable, optional
            Called repeatedly during the wait; an exception from it ends the wait.

        Returns
        -------
        tuple of str
            The other lines of the answer.

        Raises
        ------
        SafetyStop
            The printer does not answer, reports an error, resets or sends one answer too many.
        DeviceError
            The port is lost.
        """
        self._check_failure(command)
        self._write(self._exchange.begin(command))
        self._wait(limit_s, command, while_waiting)
        return self._exchange.said

    def position(self) -> gcode.Position:
        """Return the position to which the printer reports that its head was sent. Raises as `do`."""
        said = self.do(gcode.POSITION)
        if self._exchange.position is None:
            found = quoted(" ".join(said)) if said else "nothing but ok"
            raise SafetyStop(
                f"the printer's answer to {gcode.POSITION}: found {found}, expected X, Y and Z in mm with decimals"
            )
        return self._exchange.position

    def listen(self) -> None:
        """Read what the printer sent unrequested, such as a reset or an error. Raises as `do`."""
        if again := self._exchange.receive(self._port.read()):
            raise SafetyStop(f"the printer asked again for a line that it had already acknowledged: {again!r}")
        self._check_failure("rest")

    def emergency_stop(self) -> str:
        """Send M112, whatever is under way, and return the outcome in words."""
        try:
            if not self._port.write(gcode.EMERGENCY_STOP):
                return "cannot send M112: switch the printer off"
            end_s = time.monotonic() + _STOP_S
            while time.monotonic() < end_s:
                self._exchange.receive(self._port.read())
        except DeviceError as error:
            return f"cannot send M112 or read its answer ({error}): switch the printer off"
        return "sent M112: the printer stands still until you reset it; check whether the indenter still presses"

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _greeted(self) -> bool:
        self._write(self._exchange.begin_anew())
        end_s = time.monotonic() + _GREETING_S
        while time.monotonic() < end_s:
            self._exchange.receive(self._port.read())
            if self._exchange.is_done:
                return True
        return False

    def _until_quiet(self) -> None:
        quiet_since_s = time.monotonic()
        while time.monotonic() - quiet_since_s < _QUIET_S:
            if data := self._port.read():
                self._exchange.receive(data)
                quiet_since_s = time.monotonic()

    def _wait(self, limit_s: float, command: str, while_waiting: Callable[[], None] | None) -> None:
        began_s = heard_s = time.monotonic()
        busy = self._exchange.busy
        while not self._exchange.is_done:
            self._check_failure(command)
            now_s = time.monotonic()
            if now_s - heard_s > limit_s or now_s - began_s > _BUSY_MOST_S:
                raise SafetyStop(f"the printer did not answer {command} within {now_s - began_s:.0f} s")
            if while_waiting is not None:
                while_waiting()
            if again := self._exchange.receive(self._port.read()):
                self._write(again)
            if self._exchange.busy != busy:
                busy, heard_s = self._exchange.busy, time.monotonic()
        self._check_failure(command)

    def _check_failure(self, command: str) -> None:
        if self._exchange.failure:
            raise SafetyStop(f"the printer failed to execute {command}: {self._exchange.failure}")

    def _write(self, data: bytes) -> None:
        if not self._port.write(data):
            raise SafetyStop("the printer is not accepting data on the serial line")


DOWN_MM_S = 4.0
"""Speed of moves up and down, mm/s."""

# No part of a move lasts longer, so a keypress stops the head within this time.
_LONGEST_S = 0.5
_HOME_S = 120.0
# Most printers report hundredths of a mm; some tenths, rounded or cut off.
_POSITION_MM, _POSITION_STEPS = 0.015, 1.5


class Head:
    """The head over one sensor.

    Parameters
    ----------
    line : PrinterLine
        Connected.
    limits : PrinterFile
    keypress : KeypressStop

    Attributes
    ----------
    is_certain : bool
        Whether the printer has answered every command and reported the place that the head was sent to.
    was_moved : bool
        Whether the head has been sent anywhere or homed.
    free_z_mm : float
        Lowest height at which nothing is in the head's way; it moves sideways only there or higher.
    """

    def __init__(self, line: PrinterLine, limits: PrinterFile, keypress: KeypressStop) -> None:
        self._line = line
        self._limits = limits
        self._keypress = keypress
        self._place_mm: F64 = np.zeros(3)
        self.is_certain = self.was_moved = False
        self.free_z_mm = limits.start_mm[2]

    @property
    def z_mm(self) -> float:
        """Height of the head."""
        return float(self._place_mm[2])

    @property
    def is_free(self) -> bool:
        """Whether the head is certainly above the skin."""
        return self.is_certain and self.z_mm >= self.free_z_mm - _POSITION_MM

    def prepare(self, *, home: bool) -> None:
        """Set the units, keep the motors awake, home if requested, and read the head's position. Raises as `to`."""
        self._line.position()  # a position that cannot be read must end the run before anything moves
        for command in (gcode.MILLIMETRES, gcode.ABSOLUTE, gcode.stay_awake(self._line.firmware)):
            if command:
                self._line.do(command)
        if home:
            self.was_moved = True
            self._line.do(gcode.HOME, _HOME_S, self._keypress.check)
            self._line.do(gcode.WAIT_FOR_MOTION)
        self._place_mm = _place_mm(self._line.position())
        self.is_certain = True

    def to_start(self) -> None:
        """Move up if the head is lower than the start, then sideways, then down to the start. Raises as `to`."""
        x, y, z = self._limits.start_mm
        here_x, here_y, here_z = self._place_mm.tolist()
        high = max(z, here_z, self._limits.z_mm[0])
        self._go((here_x, here_y, high), DOWN_MM_S)
        self._go((x, y, high), self._limits.feed_mm_s)
        self._go((x, y, z), DOWN_MM_S)

    def over(self, x_mm: float, y_mm: float) -> None:
        """Move sideways at the present height. Raises as `to`."""
        if not self.is_free:
            raise SafetyStop(
                f"sideways move: found z at {self.z_mm:.2f} mm, expected z at {self.free_z_mm:.2f} mm or above"
            )
        self._go((x_mm, y_mm, self.z_mm), self._limits.feed_mm_s)

    def to(self, z_mm: float) -> None:
        """Move straight up or down.

        Raises
        ------
        Stopped
            A key was pressed; raised between two parts of the move.
        SafetyStop
            The move leaves the limits, or the printer does not answer, reports an error or reports another position.
        DeviceError
            The line is lost.
        """
        x, y, _ = self._place_mm.tolist()
        self._go((x, y, z_mm), DOWN_MM_S)

    def _go(self, to_mm: tuple[float, float, float], feed_mm_s: float) -> None:
        self._check_limits(to_mm)
        self._line.listen()  # the printer may have restarted, or a person may have moved it with its buttons
        self._check_place()
        # Rounded to µm as in the command, because the reported position is compared with it.
        for part in segments(self._place_mm, np.round(to_mm, 3), feed_mm_s * _LONGEST_S):
            self._keypress.check()
            if not self.is_certain:
                raise SafetyStop("the head's position is uncertain")
            self.is_certain, self.was_moved = False, True
            x, y, z = part.tolist()
            self._line.do(gcode.straight(x, y, z, feed_mm_s))
            self._line.do(gcode.WAIT_FOR_MOTION)
            self._place_mm = part
            self._check_place()
            self.is_certain = True

    def _check_place(self) -> None:
        reported = self._line.position()
        found_mm = _place_mm(reported)
        if float(np.abs(found_mm - self._place_mm).max()) > max(_POSITION_MM, _POSITION_STEPS * reported.step_mm):
            self.is_certain = False
            found, expected = (", ".join(f"{v:.2f}" for v in place.tolist()) for place in (found_mm, self._place_mm))
            raise SafetyStop(f"the printer reports the head's position as {found} mm, expected {expected} mm")

    def _check_limits(self, to_mm: tuple[float, float, float]) -> None:
        ranges = (self._limits.x_mm, self._limits.y_mm, self._limits.z_mm)
        for name, here, value, (least, most) in zip("xyz", self._place_mm.tolist(), to_mm, ranges, strict=True):
            if value != here and not least - _POSITION_MM <= value <= most + _POSITION_MM:
                raise SafetyStop(
                    f"move: found {name} {value:.2f} mm, expected {least:g} to {most:g} mm, the range in PRINTER.yaml"
                )


def _place_mm(reported: gcode.Position) -> F64:
    return np.array((reported.x_mm, reported.y_mm, reported.z_mm))


def segments(from_mm: F64, to_mm: F64, longest_mm: float) -> tuple[F64, ...]:
    """Return the ends of a straight move's equal parts, none longer than `longest_mm`; the last is `to_mm` itself."""
    parts = max(math.ceil(math.dist(from_mm, to_mm) / longest_mm), 1)
    return (*(from_mm + (to_mm - from_mm) * (k / parts) for k in range(1, parts)), to_mm)
