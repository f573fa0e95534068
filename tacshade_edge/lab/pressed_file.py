"""Presses on the simulated sensor from a file that another program, such as a hand or a machine,
replaces.
"""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.tables import number, read_columns
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.quoting import quoted

HEADER = ("indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")


class PressedFile:
    """The presses of a CSV file, ``indenter,radius_mm,depth_mm,x_mm,y_mm[,yaw_deg]``, a row per
    touching object: ``ball``, or one of the simulator's objects, with an empty radius. Without a
    row or a file nothing touches. Writers should replace the file whole (write a temporary file and
    rename it).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read: tuple[int, int] | None = None  # inode and modification time
        self._presses: tuple[Press, ...] = ()

    def at(self, _index: int) -> tuple[Press, ...]:
        """The current presses.

        Raises DecodeError, once for each content that cannot be understood.
        """
        try:
            status = self._path.stat()
        except OSError:
            self._read, self._presses = None, ()
            return ()
        # A file that is replaced within one tick of the clock has another inode.
        found = (status.st_ino, status.st_mtime_ns)
        if found != self._read:
            # Noted before it is read, so that a bad file is reported once, not for every frame.
            self._read, self._presses = found, ()
            try:
                rows, _ = read_columns(self._path, HEADER, ("yaw_deg",), "presses")
                self._presses = tuple(_press(where, row) for where, row in rows)
            except (ConfigError, ValueError) as error:
                raise DecodeError(str(error)) from None
        return self._presses


def _press(where: str, row: dict[str, str]) -> Press:
    indenter, radius_mm = row["indenter"], row["radius_mm"]
    depth_mm, x_mm, y_mm, yaw_deg = (
        number(where, key, row[key] or "0" * (key == "yaw_deg"))
        for key in ("depth_mm", "x_mm", "y_mm", "yaw_deg")
    )
    if indenter == "ball":
        shape = ball(number(where, "radius_mm", radius_mm))
    elif indenter in OBJECTS and not radius_mm:
        shape = OBJECTS[indenter]()
    else:
        raise ConfigError(
            f"{where}: indenter: found {quoted(indenter)}, "
            "expected ball, or another object with no radius_mm in its row"
        )
    return Press(shape, x_mm, y_mm, depth_mm, rotation_deg=yaw_deg)
