"""A serial port through pyserial: bytes only. The daemon decides when to retry and what to log."""

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
_NO_DATA = "readiness to read but returned no data"  # pyserial's message, which has no errno
_CAUSES = {
    errno.ENOENT: (ReasonCode.ABSENT, "no such device"),
    errno.EAGAIN: (ReasonCode.IN_USE, "in use by another program"),
    errno.EACCES: (ReasonCode.PERMISSION, "no permission"),
    errno.EIO: (ReasonCode.LOST, "unplugged"),
    errno.ENXIO: (ReasonCode.LOST, "unplugged"),
}


class SerialPort:
    """One port, opened and closed as often as needed.

    All methods belong to one thread, except `wake`.

    `device`: a path under /dev, preferably under /dev/serial/by-id; or a pyserial URL
    (``socket://HOST:PORT``). `baud`: bits per second; USB devices without a UART ignore it.
    `dtr`: False keeps DTR and RTS low while it is open.
    """

    def __init__(self, device: str, baud: int, *, dtr: bool = True) -> None:
        self.device = device
        self.baud = baud
        self._dtr = dtr
        self._low_latency = False
        self._proven = False
        self._port: serial.Serial | None = None
        # For `wake`, which another thread calls while this one may close the port: the number of a
        # closed descriptor may already belong to another file.
        self._closing = threading.Lock()

    def open(self) -> None:
        """Open the port for exclusive use.

        Raises DeviceError (absent, in use, no permission), ConfigError (it can never work: not a
        device, an unknown kind of URL. A port that has worked raises DeviceError).
        """
        self.close()
        try:
            check_kind(self.device)
        except ConfigError as error:
            # It worked before: the path under /dev has changed, and may change back.
            if self._proven:
                raise DeviceError(str(error), code=error.code) from None
            raise
        try:
            port = serial.serial_for_url(self.device, do_not_open=True)
            port.baudrate = self.baud
            port.timeout, port.write_timeout = READ_S, WRITE_S
            # A second program would take some of the bytes, and both would see garbage.
            port.exclusive = True
            # Before it is open: else pyserial raises both as it opens.
            port.dtr = port.rts = self._dtr
            port.open()
        except ValueError as error:  # pyserial: the port does not support this rate
            raise ConfigError(
                f"serial {self.device}: {error}; expected a baud rate that the port supports"
            ) from None
        except (OSError, termios.error) as error:
            raise self._failed(error) from error
        self._port, self._proven = port, True
        self._low_latency = False
        # USB CDC, a pty, a URL.
        with contextlib.suppress(AttributeError, NotImplementedError, ValueError):
            port.set_low_latency_mode(True)
            self._low_latency = True

    def read(self) -> bytes:
        """Return the received bytes; wait at most `READ_S` for the first.

        Raises DeviceError when the port is lost.
        """
        port = self._opened()
        try:
            # One byte first, then what is there: asked for a chunk, pyserial waits `READ_S` for
            # all of it, and every pose would be that late.
            first = bytes(port.read(1))
            return first + bytes(port.read(min(port.in_waiting, _CHUNK))) if first else first
        except (OSError, termios.error) as error:
            raise self._failed(error) from error

    def write(self, data: bytes) -> bool:
        """Write bytes; return False if the port did not take all within `WRITE_S`:
        nobody reads at the other end.
        """
        port = self._opened()
        try:
            port.write(data)
        except serial.SerialTimeoutException:
            return False
        except (OSError, termios.error) as error:
            raise self._failed(error) from error
        return True

    def unsent(self) -> int:
        """Return how many written bytes wait in the driver; 0 if it keeps no count.

        Raises DeviceError.
        """
        try:
            return int(getattr(self._opened(), "out_waiting", 0))
        except (OSError, termios.error) as error:
            raise self._failed(error) from error

    def wake(self) -> None:
        """Make a waiting `read` return; callable from any thread."""
        with self._closing:
            cancel = getattr(self._port, "cancel_read", None)
            if cancel is not None:
                cancel()

    def close(self) -> None:
        """Close the port; safe to call twice."""
        with self._closing:
            port, self._port = self._port, None
            if port is not None:
                port.close()

    def describe(self) -> dict[str, str | int | float]:
        """Return details for ``status/serial``; `latency_ms` is how long an FTDI chip may hold
        bytes back.
        """
        details: dict[str, str | int | float] = {"device": self.device, "baud": self.baud}
        if self._port is not None and self._low_latency:
            details["low_latency"] = "yes"
        timer = (
            Path("/sys/class/tty") / Path(self.device).resolve().name / "device" / "latency_timer"
        )
        with contextlib.suppress(OSError, ValueError):  # no FTDI chip
            details["latency_ms"] = int(timer.read_text())
        return details

    def _failed(self, error: BaseException) -> DeviceError:
        """Return the error in one line; our text replaces pyserial's if the cause is known."""
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
    """Raise ConfigError if waiting cannot help: an existing path that is no device,
    or an unknown kind of URL.
    """
    if "://" in device:
        try:
            serial.serial_for_url(device, do_not_open=True)
        except ValueError as error:
            raise ConfigError(
                f"serial {device}: {error}; expected a device or a pyserial URL"
            ) from None
    elif (path := Path(device)).exists() and not stat.S_ISCHR(path.stat().st_mode):
        found = "found another kind of file, expected a serial port's character device"
        raise ConfigError(f"serial {device}: {found}", code=ReasonCode.WRONG_KIND)
