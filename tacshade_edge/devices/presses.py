"""PRESSES.csv: known ball presses, for ``tacshade-edge calibrate``."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from tacshade_edge.core.calibrate import BallPress
from tacshade_edge.devices.images import read_image
from tacshade_edge.errors import ConfigError, DecodeError

HEADER = ("image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")


def read_presses(path: Path) -> list[BallPress]:
    """Read the table and its images (relative to the table).

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``, or an image that cannot be read.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream, strict=True)
            lines = [(reader.line_num, row) for row in reader if row]
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}, expected a CSV file of presses") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: not a CSV file: {error}") from None
    if not lines or tuple(lines[0][1]) != HEADER:
        found = ",".join(lines[0][1]) if lines else "nothing"
        raise ConfigError(f"{path}:1: found the header {found[:80]}, expected {','.join(HEADER)}")
    return [_press(path, line, row) for line, row in lines[1:]]


def _press(path: Path, line: int, row: list[str]) -> BallPress:
    where = f"{path}:{line}"
    if len(row) != len(HEADER):
        raise ConfigError(f"{where}: found {len(row)} columns, expected {len(HEADER)}")
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
        radius_mm=_number(where, "radius_mm", numbers[0]),
        depth_mm=_number(where, "depth_mm", numbers[1]),
        x_mm=_number(where, "x_mm", numbers[2]) if numbers[2] else None,
        y_mm=_number(where, "y_mm", numbers[3]) if numbers[3] else None,
    )


def _number(where: str, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where}: {column}: found {text!r}, expected a number")
    return value
