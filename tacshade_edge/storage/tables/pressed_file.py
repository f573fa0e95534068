"""Presses on the simulated sensor from a file that another program, such as a hand or a machine, replaces."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted
from tacshade_edge.simulator.press import OBJECTS, Press, ball
from tacshade_edge.storage.tables.tables import number, read_rows

HEADER = ("indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")
MORE = ("yaw_deg",)
"""Optional columns; an empty cell means 0."""


class PressedFile:
    """The presses of a CSV file, ``indenter,radius_mm,depth_mm,x_mm,y_mm[,yaw_deg]``, with one row per touching object.

    An indenter is ``ball``, or one of the simulator's objects, with an empty radius. Without a row or a file nothing
    touches. Writers should replace the file whole (write a temporary file and rename it).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read: tuple[int, int] | None = None  # inode and modification time
        self._presses: tuple[Press, ...] = ()

    def at(self, _index: int) -> tuple[Press, ...]:
        """The current presses. Raises DecodeError, once for each content that cannot be understood."""
        try:
            status = self._path.stat()
        except OSError:
            self._read, self._presses = None, ()
            return ()
        found = (status.st_ino, status.st_mtime_ns)
        if found != self._read:
            self._read, self._presses = found, ()
            try:
                self._presses = tuple(
                    _press(where, row) for where, row in read_rows(self._path, HEADER, "presses", more=MORE)
                )
            except (ConfigError, ValueError) as error:
                raise DecodeError(str(error)) from None
        return self._presses


def _press(where: str, row: list[str]) -> Press:
    indenter, radius_text, depth_text, x_text, y_text, *more = row
    texts = zip(HEADER[2:], (depth_text, x_text, y_text), strict=True)
    depth_mm, x_mm, y_mm = (number(where, name, text) for name, text in texts)
    yaw_deg = number(where, MORE[0], more[0]) if more and more[0] else 0.0
    if indenter == "ball":
        shape = ball(number(where, "radius_mm", radius_text))
    elif indenter in OBJECTS and not radius_text:
        shape = OBJECTS[indenter]()
    else:
        raise ConfigError(
            f"{where}: indenter: found {quoted(indenter)}, "
            "expected ball, or another object with no radius_mm in its row"
        )
    return Press(shape, x_mm, y_mm, depth_mm, rotation_deg=yaw_deg)
