"""A scale on a serial port: a separate thread collects its readings and their arrival times."""

from __future__ import annotations

import threading
import time

import numpy as np

from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.protocol.scale import UNITS, parse_reading
from tacshade_edge.types import F64

BAUD = 9600
READINGS_MAX = 1 << 20
_LINE_BYTES_MAX = 256
_SILENT_S = 5.0
GAP_S = 1.0


def scale_port(text: str) -> SerialPort:
    """Return the serial port that ``DEVICE[:BAUD]`` names."""
    device, colon, baud = text.rpartition(":")
    if colon and baud.isdecimal() and "://" not in text:
        return SerialPort(device, int(baud))
    return SerialPort(text, BAUD)


class Scale:
    """A scale that a thread reads from `open` to `close`."""

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self._lock = threading.Lock()
        self._t_s: list[float] = []
        self._force_n: list[float] = []
        self._unread = b""
        self._heard_s = 0.0
        self._error: DeviceError | ConfigError | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scale", daemon=True)

    def open(self) -> None:
        """Open the port and start reading. Raises DeviceError, ConfigError."""
        self._port.open()
        self._heard_s = time.monotonic()
        self._thread.start()

    def close(self) -> None:
        """Stop reading and close the port."""
        self._stop.set()
        self._port.wake()
        if self._thread.ident is not None:
            self._thread.join(1.0)
        self._port.close()

    def check(self) -> None:
        """Raise the reader's error, or DeviceError if the scale sends no readings or has sent too many."""
        if self._error is not None:
            raise self._error
        if len(self._t_s) >= READINGS_MAX:
            raise DeviceError(
                f"scale {self._port.device}: reached the limit of {READINGS_MAX} readings per run; start a new run"
            )
        if time.monotonic() - self._heard_s > _SILENT_S:
            found = repr(self._unread.decode("ascii", "replace")) if self._unread else "nothing"
            expected = (
                f"expected lines with a number and a unit ({UNITS}); does the scale send at {self._port.baud} baud?"
            )
            raise DeviceError(f"scale {self._port.device}: found {found} in the last {_SILENT_S:.0f} s, {expected}")

    def readings(self) -> tuple[F64, F64]:
        """All readings so far: arrival in s of CLOCK_MONOTONIC, and force in N; both (m,)."""
        with self._lock:
            return np.array(self._t_s), np.array(self._force_n)

    def median_n(self, since_s: float) -> tuple[float, float]:
        """Median of the readings since `since_s` and their spread from the 5th to the 95th percentile; NaN if none."""
        t_s, force_n = self.readings()
        recent = force_n[t_s >= since_s]
        if not len(recent):
            return float("nan"), float("nan")
        low, middle, high = np.percentile(recent, (5, 50, 95))
        return float(middle), float(high - low)

    def _run(self) -> None:
        buffer = b""
        while not self._stop.is_set():
            try:
                data = self._port.read()
            except (DeviceError, ConfigError) as error:
                self._error = error
                return
            now_s = time.monotonic()
            *lines, buffer = (buffer + data).replace(b"\r", b"\n").split(b"\n")
            buffer = buffer[-_LINE_BYTES_MAX:]
            for line in filter(None, lines):
                force_n = parse_reading(line)
                if force_n is None:
                    self._unread = line[:40]
                    continue
                self._heard_s = now_s
                with self._lock:
                    if len(self._t_s) < READINGS_MAX:
                        self._t_s.append(now_s)
                        self._force_n.append(force_n)


def force_at(at_s: float, t_s: F64, force_n: F64) -> float | None:
    """Return the force in N, interpolated between readings at most `GAP_S` apart; None elsewhere."""
    after = int(np.searchsorted(t_s, at_s))
    if not 0 < after < len(t_s) or t_s[after] - t_s[after - 1] > GAP_S:
        return None
    return float(np.interp(at_s, t_s, force_n))
