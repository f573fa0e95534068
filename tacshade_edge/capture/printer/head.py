"""Moves the printer's head in short parts within its limits and checks the reported position after each."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.capture.live import InputEnded, Terminal
from tacshade_edge.capture.printer.line import PrinterLine, SafetyStop, Stopped
from tacshade_edge.protocol import gcode
from tacshade_edge.settings.sensor_file import PrinterFile
from tacshade_edge.types import F64

DOWN_MM_S = 4.0
"""Speed of moves up and down, mm/s."""

# No part of a move lasts longer, so a keypress stops the head within this time.
_LONGEST_S = 0.5
_HOME_S = 120.0
# Most printers report hundredths of a mm; some tenths, rounded or cut off.
_POSITION_MM, _POSITION_STEPS = 0.015, 1.5


class KeypressStop:
    """A check for keypresses at a terminal. `terminal`: inside its `keys` context while anything moves."""

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


class Head:
    """The head over one sensor. `line`: connected. `is_certain`: whether the printer has answered every command and
    reported the place that the head was sent to. `was_moved`: whether the head has been sent anywhere or homed.
    `free_z_mm`: lowest height at which nothing is in the head's way; it moves sideways only there or higher.
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
        """Move straight up or down. Raises Stopped (a key was pressed; raised between two parts of the move),
        SafetyStop (the move leaves the limits, or the printer does not answer, reports an error or reports another
        position), DeviceError (the line is lost).
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
