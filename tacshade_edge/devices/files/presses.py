"""PRESSES.csv: known ball presses, for ``tacshade-edge calibrate``."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.core.calibration.inputs import BallPress
from tacshade_edge.devices.files.images import read_image
from tacshade_edge.devices.files.tables import number, read_rows
from tacshade_edge.errors import ConfigError, DecodeError

HEADER = ("image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")


def read_presses(path: Path) -> list[BallPress]:
    """Read the table and its images (relative to the table).

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``, or an image that cannot be read.
    """
    return [_press(path, where, row) for where, row in read_rows(path, HEADER, "presses")]


def _press(path: Path, where: str, row: list[str]) -> BallPress:
    name, indenter, *numbers = row
    if indenter != "ball":
        raise ConfigError(f"{where}: indenter: found {indenter!r}, expected ball")
    if (numbers[2] == "") != (numbers[3] == ""):
        raise ConfigError(f"{where}: x_mm, y_mm: found one of them, expected both or none")
    try:
        image = read_image(path.parent / name)
    except DecodeError as error:
        raise ConfigError(f"{where}: image: {error}") from None
    return BallPress(
        name=f"{where}: {name}",
        image=image,
        radius_mm=number(where, "radius_mm", numbers[0]),
        depth_mm=number(where, "depth_mm", numbers[1]),
        x_mm=number(where, "x_mm", numbers[2]) if numbers[2] else None,
        y_mm=number(where, "y_mm", numbers[3]) if numbers[3] else None,
    )
