"""What presses the simulated sensor now, from a file that another program replaces: a hand, or a machine."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted
from tacshade_edge.simulator.objects import OBJECTS, ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.storage.tables.tables import number, read_rows

HEADER = ("indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")
MORE = ("yaw_deg",)
"""Columns that it may have too; an empty cell is 0."""


class PressedFile:
    """The presses of a CSV file, ``indenter,radius_mm,depth_mm,x_mm,y_mm[,yaw_deg]``: one row for each that touches.

    An indenter is ``ball``, or an object of the simulator, whose radius is empty. No row, or no file: nothing touches.
    The file should be replaced whole (written beside its place and renamed).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read: tuple[int, int] | None = None  # which file, and when it was changed
        self._presses: tuple[Press, ...] = ()

    def at(self, _index: int) -> tuple[Press, ...]:
        """What touches now. Raises DecodeError, once for each content that cannot be understood."""
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
        raise ConfigError(f"{where}: indenter: found {quoted(indenter)}, expected ball, or a name without a radius_mm")
    return Press(shape, x_mm, y_mm, depth_mm, rotation_deg=yaw_deg)
