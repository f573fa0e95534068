"""The printer's serial line: one command at a time, its answer, and a time limit."""

from __future__ import annotations

import time
from collections.abc import Callable

from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.errors import DeviceError
from tacshade_edge.protocol import gcode
from tacshade_edge.quoting import quoted

# A board that resets when its port opens answers only after its boot loader, which takes seconds.
_GREETINGS, _GREETING_S = 6, 3.0
_QUIET_S = 0.5
ANSWER_S = 10.0
"""Time limit in s for the answer to a command that moves the head for at most half a second."""

# Longest wait for a printer that keeps reporting that it is busy.
_BUSY_MOST_S = 180.0
_STOP_S = 1.0


class SafetyStop(DeviceError):
    """Something is not as expected, so nothing may move any further."""


class Stopped(Exception):
    """A person or a signal stopped the machine."""


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

        `limit_s`: longest time without an answer or a report that the printer is busy. `while_waiting`: called
        repeatedly during the wait; an exception from it ends the wait. Returns: the other lines of the answer. Raises
        SafetyStop (the printer does not answer, reports an error, resets or sends one answer too many), DeviceError
        (the port is lost).
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
        began_s = quiet_since_s = time.monotonic()
        while (now_s := time.monotonic()) - quiet_since_s < _QUIET_S:
            if now_s - began_s > ANSWER_S:
                raise DeviceError(
                    f"printer {self._port.device}: found {ANSWER_S:.0f} s of unrequested lines, expected a printer"
                )
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
