"""A scale on a serial port: a separate thread collects its readings and their arrival times."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.tables import NUMBER_MAX
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.types import F64

STANDARD_GRAVITY_M_S2: Final = 9.80665
_POUND_KG: Final = 0.45359237
_KG: Final = {"mg": 1e-6, "g": 1e-3, "kg": 1.0, "lb": _POUND_KG, "oz": _POUND_KG / 16}
_NEWTONS: Final = {"n": 1.0, "mn": 1e-3, "kn": 1e3} | {
    name + force: STANDARD_GRAVITY_M_S2 * kg for name, kg in _KG.items() for force in ("", "f")
}
UNITS: Final = "g, kg, mg, N, mN, kN, lb, oz"
_READING = re.compile(r"([+-]?) *(\d+(?:[.,]\d+)?|[.,]\d+) *([a-z]+)", re.IGNORECASE)


def parse_reading(line: bytes) -> float | None:
    """The force in N that a line reports, a mass as its weight;
    None if it has no number with a known unit, or one that no scale shows.

    ``ST,GS,+  0.123 kg``, ``-12,5g`` and ``1.2 N`` are readings.
    """
    for sign, digits, unit in _READING.findall(line.decode("ascii", "replace")):
        if (newtons := _NEWTONS.get(unit.lower())) is not None:
            force_n = float(digits.replace(",", ".")) * newtons
            # What no table takes is no reading of a scale.
            return (-force_n if sign == "-" else force_n) if force_n <= NUMBER_MAX else None
    return None


BAUD = 9600
# A device that is no scale may never end a line.
_LINE_BYTES_MAX = 256
_SILENT_S = 5.0
# Between readings further apart, the force may have been anything.
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
        # `close` also follows an `open` that failed before the thread started.
        if self._thread.ident is not None:
            self._thread.join(1.0)
        self._port.close()

    def check(self) -> None:
        """Raise the reader's error, or DeviceError if the scale sends no readings."""
        if self._error is not None:
            raise self._error
        if time.monotonic() - self._heard_s > _SILENT_S:
            found = repr(self._unread.decode("ascii", "replace")) if self._unread else "nothing"
            expected = f"expected lines with a number and a unit ({UNITS})"
            asked = f"does the scale send at {self._port.baud} baud?"
            found = f"found {found} in the last {_SILENT_S:.0f} s"
            raise DeviceError(f"scale {self._port.device}: {found}, {expected}; {asked}")

    def readings(self) -> tuple[F64, F64]:
        """All readings so far: arrival in s of CLOCK_MONOTONIC, and force in N; both (m,)."""
        with self._lock:
            return np.array(self._t_s), np.array(self._force_n)

    def median_n(self, since_s: float) -> tuple[float, float]:
        """Median of the readings since `since_s` and their spread from the 5th
        to the 95th percentile; NaN if none.
        """
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
            # The time of the read: a scale sends no time of its own, and the offset corrects what
            # is constant.
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
                    self._t_s.append(now_s)
                    self._force_n.append(force_n)


def force_at(at_s: float, t_s: F64, force_n: F64) -> float | None:
    """Return the force in N, interpolated between readings at most `GAP_S` apart;
    None elsewhere.
    """
    after = int(np.searchsorted(t_s, at_s))
    if not 0 < after < len(t_s) or t_s[after] - t_s[after - 1] > GAP_S:
        return None
    return float(np.interp(at_s, t_s, force_n))


RANGE_S, _STEP_S = 1.0, 0.005
PRESSES_LEAST = 3
# Fewer frames or readings correlate well by chance.
_LEAST_POINTS = 5
_CORRELATION_LEAST = 0.8
ERROR_MOST_S = 0.05


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """A scale's clock offset and its standard error:
    a picture of time t shows the force read at t + `offset_s`.
    """

    offset_s: float
    error_s: float
    presses: int


@dataclass(frozen=True, slots=True, eq=False)
class ScalePress:
    """Times in s and the picture's change, both (n,),
    from before a press until after it was lifted.
    """

    t_s: F64
    change: F64


def find_offset(presses: Sequence[ScalePress], t_s: F64, force: F64) -> ClockOffset:
    """Find the offset as the mean lag of the presses; their scatter gives its standard error.

    Each press is correlated (Pearson) with the force at every lag from -`RANGE_S` to `RANGE_S`; a
    parabola through the greatest correlation and its neighbours locates the peak between the steps.

    `t_s`, `force` (float64 (m,)): the scale's readings and their arrival times, ascending. Raises
    ValueError (``found …, expected …``: why the offset cannot be found).
    """
    lags = [lag for press in presses if (lag := _lag_s(press, t_s, force)) is not None]
    if len(lags) < PRESSES_LEAST:
        found = (
            f"found {len(lags)} presses (of {len(presses)}) "
            "in which picture and force rise and fall together"
        )
        raise ValueError(
            f"{found}, expected at least {PRESSES_LEAST}, each pressed and lifted while recording"
        )
    error_s = float(np.std(lags, ddof=1) / np.sqrt(len(lags)))
    if error_s > ERROR_MOST_S:
        found = f"found clock offsets that differ by {1e3 * np.ptp(lags):.0f} ms between presses"
        raise ValueError(
            f"{found}, expected a standard error of at most {1e3 * ERROR_MOST_S:.0f} ms"
        )
    return ClockOffset(float(np.mean(lags)), error_s, len(lags))


def _lag_s(press: ScalePress, t_s: F64, force: F64) -> float | None:
    """Return one press's lag in s; None if it correlates too weakly or best at the end
    of the range.
    """
    if min(len(press.t_s), len(t_s)) < _LEAST_POINTS:
        return None
    lags = np.arange(-RANGE_S, RANGE_S + _STEP_S / 2, _STEP_S)
    seen = press.change - press.change.mean()
    read = np.interp(press.t_s[None, :] + lags[:, None], t_s, force)
    read -= read.mean(axis=1, keepdims=True)
    size = np.sqrt((read * read).sum(axis=1) * (seen @ seen))
    found = np.divide(read @ seen, size, out=np.zeros(len(lags)), where=size > 0)
    at = int(found.argmax())
    # At the end of the range the true lag may lie beyond, and there is no neighbour for the
    # parabola.
    if not 0 < at < len(lags) - 1 or found[at] < _CORRELATION_LEAST:
        return None
    before, best, after = found[at - 1 : at + 2]
    bend = before - 2 * best + after
    return float(lags[at] + (_STEP_S * 0.5 * (before - after) / bend if bend < 0 else 0.0))
