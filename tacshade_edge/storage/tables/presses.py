"""PRESSES.csv: known presses, for ``tacshade-edge calibrate``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.tables.tables import number, read_columns
from tacshade_edge.types import U8

BALL = "ball"
"""The indenter without an entry in INDENTERS.yaml."""

HEADER = ("image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")
MORE = ("yaw_deg", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm")
"""Optional columns; an empty cell means 0."""

_MOST_DEG = {"yaw_deg": 360.0, "tilt_x_deg": 60.0, "tilt_y_deg": 60.0}


def read_presses(
    path: Path, indenters: Mapping[str, Indenter | float] | None = None
) -> tuple[list[KnownPress], tuple[str, ...]]:
    """Read the table and its images (relative to it), and notes on it for a person; `indenters` are INDENTERS.yaml's.

    Raises ConfigError for a mistake (``FILE:LINE: column: found …, expected …``), or if an image is unreadable.
    """
    rows, notes = press_rows(path)
    presses, mistakes = list[KnownPress](), list[str]()
    for where, row in rows:
        try:
            presses.append(_press(path, where, row, indenters or {}))
        except ConfigError as error:
            mistakes.append(str(error))
    if mistakes:
        raise ConfigError(mistakes[0], others=mistakes[1:])
    return presses, notes


def press_rows(path: Path) -> tuple[list[tuple[str, dict[str, str]]], tuple[str, ...]]:
    """The rows, each ``FILE:LINE`` and its cells by column with decimal points, and notes for a person.

    Raises ConfigError if the table is absent or not such a table.
    """
    table = read_columns(path, HEADER, MORE, "presses")
    notes: tuple[str, ...] = ()
    if table.unknown:
        names = ", ".join(shown(name or "one without a name", 40) for name in table.unknown[:10])
        notes = (f"{path}: ignoring unknown columns: {names}",)
    rows = [(where, table.with_points(row, ("image", "indenter"))) for where, row in table.rows]
    return rows, notes


def _press(path: Path, where: str, row: dict[str, str], indenters: Mapping[str, Indenter | float]) -> KnownPress:
    name = row["indenter"]
    if name != BALL and name not in indenters:
        others = (
            f" or an indenter from INDENTERS.yaml: {', '.join(indenters)}"
            if indenters
            else " (other indenters need --indenters)"
        )
        raise ConfigError(f"{where}: indenter: found {quoted(name)}, expected ball{others}")
    indenter = None if name == BALL else indenters[name]
    if indenter is not None and row["radius_mm"].strip():
        raise ConfigError(
            f"{where}: radius_mm: found {quoted(row['radius_mm'])}, "
            "expected nothing, because INDENTERS.yaml states the radius"
        )
    place = [row[column].strip() for column in ("x_mm", "y_mm")]
    if (place[0] == "") != (place[1] == ""):
        raise ConfigError(f"{where}: x_mm, y_mm: found only one value, expected both or neither")
    if isinstance(indenter, Indenter) and not place[0]:
        raise ConfigError(
            f"{where}: x_mm, y_mm: found no values, expected both values; only a ball press may omit them"
        )
    try:
        image = read_image(named_file(path.parent, row["image"]))
    except DecodeError as error:
        raise ConfigError(f"{where}: image: {error}") from None
    # x and y already give the indenter's place in the image; the drag does not matter but must be a number.
    columns = ("depth_mm", *["radius_mm"] * (indenter is None), *["x_mm", "y_mm"] * bool(place[0]))
    for column in (*columns, *(column for column in MORE if row.get(column, "").strip())):
        value, most = number(where, column, row[column]), _MOST_DEG.get(column, math.inf)
        if abs(value) > most:
            raise ConfigError(
                f"{where}: {column}: found {quoted(row[column])}, expected a number from -{most:g} to {most:g}"
            )
    return known_press(f"{where}: {row['image']}", image, row, indenters)


def known_press(name: str, image: U8, row: Mapping[str, str], indenters: Mapping[str, Indenter | float]) -> KnownPress:
    """The press in a row whose cells have been checked; `indenters` holds those in addition to the ball."""
    indenter = indenters.get(row["indenter"])
    x_mm, y_mm = (float(row[column]) if row[column].strip() else None for column in ("x_mm", "y_mm"))
    ball_mm = float(row["radius_mm"]) if indenter is None else indenter if isinstance(indenter, float) else 0.0
    solid = indenter if isinstance(indenter, Indenter) else None
    angles = (float(row.get(column, "").strip() or 0) for column in MORE[:3])
    return KnownPress(name, image, ball_mm, float(row["depth_mm"]), x_mm, y_mm, solid, *angles)
