"""A host's end of the serial line (docs/reference/serial.md):
send poses and commands, synchronise the clocks.
"""

from __future__ import annotations

import binascii
import time
from typing import Protocol


class Port(Protocol):
    """The methods of pyserial's ``serial.Serial(device, 115200,
    timeout=0.1)`` that `Daemon` uses.
    """

    def write(self, data: bytes, /) -> object: ...

    def read_until(self, end: bytes, /) -> bytes: ...


def seal(text: str) -> bytes:
    """Return the line with its checksum and LF."""
    raw = text.encode("ascii")
    return b"%s*%04X\n" % (raw, binascii.crc_hqx(raw, 0))


class Daemon:
    """The daemon at the other end; `boot` has 1 to 16 letters and digits
    and changes whenever the robot starts.
    """

    def __init__(self, port: Port, boot: str) -> None:
        self.port = port
        self.seq = 0
        self.t4: int | None = None
        self.command(f"HELLO 1 crc=req boot={boot}")

    def command(self, text: str, seconds: float = 10.0) -> list[str]:
        """Return the words of the answer after OK and its number.

        The line may be resent, but it is executed once.
        """
        self.seq = (self.seq + 1) % 65536
        give_up = time.monotonic() + seconds
        while time.monotonic() < give_up:
            self.port.write(seal(f"#{self.seq} {text}"))
            again = time.monotonic() + 0.5
            while time.monotonic() < again:
                raw, _, crc = self.port.read_until(b"\n").strip().rpartition(b"*")
                if crc != b"%04X" % binascii.crc_hqx(raw, 0):
                    continue
                word, *rest = raw.decode("ascii").split(" ")
                if word in ("OK", "ERR") and rest[0] == str(self.seq):
                    if word == "ERR":
                        raise RuntimeError(" ".join(rest[1:]))
                    return rest[1:]
        raise TimeoutError(text)

    def sync(self) -> None:
        """Exchange clocks; call at least once a second."""
        t1 = time.monotonic_ns()
        self.command(f"SYNC {t1}" if self.t4 is None else f"SYNC {t1} {self.t4}")
        self.t4 = time.monotonic_ns()

    def pose(
        self, t_ns: int, x: float, y: float, z: float, qw: float, qx: float, qy: float, qz: float
    ) -> None:
        """Send the flange's pose in the base frame at `t_ns` of `time.monotonic_ns`:
        mm, unit quaternion.
        """
        self.port.write(
            seal(f"POSE {t_ns} {x:.3f} {y:.3f} {z:.3f} {qw:.6f} {qx:.6f} {qy:.6f} {qz:.6f}")
        )
