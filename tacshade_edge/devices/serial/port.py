"""A serial port through pyserial: bytes and nothing else. Policy (when to try again, what to say) is the daemon's."""

from __future__ import annotations

import contextlib
import errno
import stat
import termios
import threading
from pathlib import Path

import serial

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import ReasonCode

READ_S = 0.05
WRITE_S = 0.1
_CHUNK = 4096
_NO_DATA = "readiness to read but returned no data"  # of pyserial, without a number
_CAUSES = {
    errno.ENOENT: (ReasonCode.ABSENT, "no such device"),
    errno.EAGAIN: (ReasonCode.IN_USE, "in use by another program"),
    errno.EACCES: (ReasonCode.PERMISSION, "no permission"),
    errno.EIO: (ReasonCode.LOST, "unplugged"),
    errno.ENXIO: (ReasonCode.LOST, "unplugged"),
}


class SerialPort:
    """One port, opened and closed as often as needed. All methods belong to one thread, except `wake`.

    Parameters
    ----------
    device : str
        A path under /dev, best one under /dev/serial/by-id; or a pyserial URL (``socket://HOST:PORT``).
    baud : int
        Bits per second; USB devices without a UART ignore it.
    """

    def __init__(self, device: str, baud: int) -> None:
        self.device = device
        self.baud = baud
        self._low_latency = ""
        self._proven = False
        self._port: serial.Serial | None = None
        self._closing = threading.Lock()  # a descriptor that was closed may be another's already

    def open(self) -> None:
        """Open for this process alone.

        Raises
        ------
        DeviceError
            Absent, in use, no permission.
        ConfigError
            It can never work: no device, an unknown kind of URL. Once it has worked it is a DeviceError.
        """
        self.close()
        try:
            check_kind(self.device)
        except ConfigError as error:
            if self._proven:  # it worked before: it is the place under /dev that changed, and may change back
                raise DeviceError(str(error), code=error.code) from None
            raise
        try:
            port = serial.serial_for_url(self.device, do_not_open=True)
            port.baudrate = self.baud
            port.timeout, port.write_timeout = READ_S, WRITE_S
            port.exclusive = True
            port.open()
        except ValueError as error:  # of pyserial: a rate that this port does not know
            raise ConfigError(f"serial {self.device}: {error}, expected a rate that the port supports") from None
        except (OSError, termios.error) as error:
            raise self._failed(error) from error
        self._port, self._proven = port, True
        self._low_latency = _set_low_latency(port)

    def read(self) -> bytes:
        """What has come; waits at most `READ_S` for the first byte. Raises DeviceError when the port is lost."""
        port = self._opened()
        try:
            first = bytes(port.read(1))
            return first + bytes(port.read(min(port.in_waiting, _CHUNK))) if first else first
        except (OSError, termios.error) as error:
            raise self._failed(error) from error

    def write(self, data: bytes) -> bool:
        """Give bytes to the port; False when it took not all within `WRITE_S`: nobody reads at the other end."""
        port = self._opened()
        try:
            port.write(data)
        except serial.SerialTimeoutException:
            return False
        except (OSError, termios.error) as error:
            raise self._failed(error) from error
        return True

    def unsent(self) -> int:
        """How many bytes that `write` took wait in the driver; 0 where it keeps no count. Raises DeviceError."""
        try:
            return int(getattr(self._opened(), "out_waiting", 0))
        except (OSError, termios.error) as error:
            raise self._failed(error) from error

    def wake(self) -> None:
        """Make a `read` that waits return; from any thread."""
        with self._closing:
            cancel = getattr(self._port, "cancel_read", None)
            if cancel is not None:
                cancel()

    def close(self) -> None:
        """Let go of the port; safe to call twice."""
        with self._closing:
            port, self._port = self._port, None
            if port is not None:
                port.close()

    def describe(self) -> dict[str, str | int | float]:
        """For ``status/serial``; `latency_ms` is how long an FTDI chip may hold bytes back."""
        details: dict[str, str | int | float] = {"device": self.device, "baud": self.baud}
        if self._port is not None and self._low_latency:
            details["low_latency"] = self._low_latency
        timer = Path("/sys/class/tty") / Path(self.device).resolve().name / "device" / "latency_timer"
        with contextlib.suppress(OSError, ValueError):  # no FTDI chip
            details["latency_ms"] = int(timer.read_text())
        return details

    def _failed(self, error: BaseException) -> DeviceError:
        """On one line, and in the place of pyserial's words ours where the cause is known."""
        number = error.errno if isinstance(error, OSError) else None
        code, text = _CAUSES.get(number or 0, (ReasonCode.DEVICE, " ".join(str(error).split())))
        if code is ReasonCode.DEVICE and _NO_DATA in text:
            code, text = ReasonCode.LOST, "unplugged, or a second program reads from it"
        return DeviceError(f"serial {self.device}: {text}", code=code)

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise DeviceError(f"serial {self.device}: not open")
        return self._port


def check_kind(device: str) -> None:
    """Raises ConfigError where waiting cannot help: a path that is there and is no device, a URL of no known kind."""
    if "://" in device:
        try:
            serial.serial_for_url(device, do_not_open=True)
        except ValueError as error:
            raise ConfigError(f"serial {device}: {error}, expected a device or a pyserial URL") from None
    elif (path := Path(device)).exists() and not stat.S_ISCHR(path.stat().st_mode):
        found = "found no character device, expected a serial port"
        raise ConfigError(f"serial {device}: {found}", code=ReasonCode.WRONG_KIND)


def _set_low_latency(port: serial.Serial) -> str:
    try:
        port.set_low_latency_mode(True)
    except (AttributeError, NotImplementedError, ValueError):
        return ""  # a port without the setting: USB CDC, a pty, a URL
    return "yes"
