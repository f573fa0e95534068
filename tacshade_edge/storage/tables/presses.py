"""PRESSES.csv: known presses, for ``tacshade-edge calibrate``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.tables.tables import number, read_columns

BALL = "ball"
"""The indenter without an entry in INDENTERS.yaml."""

HEADER = ("image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")
MORE = ("yaw_deg", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm")
"""Optional columns; an empty cell means 0."""

_YAW_MOST_DEG, _TILT_MOST_DEG = 360.0, 60.0


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
    angles = [
        _within(where, row, "yaw_deg", _YAW_MOST_DEG),
        _within(where, row, "tilt_x_deg", _TILT_MOST_DEG),
        _within(where, row, "tilt_y_deg", _TILT_MOST_DEG),
    ]
    # x and y already give the indenter's place in the image; the drag does not matter but must be a number.
    for column in MORE[3:]:
        _optional(where, row, column)
    if indenter is None:
        radius_mm = number(where, "radius_mm", row["radius_mm"])
    else:
        radius_mm = 0.0 if isinstance(indenter, Indenter) else indenter
    return KnownPress(
        name=f"{where}: {row['image']}",
        image=image,
        radius_mm=radius_mm,
        depth_mm=number(where, "depth_mm", row["depth_mm"]),
        x_mm=number(where, "x_mm", place[0]) if place[0] else None,
        y_mm=number(where, "y_mm", place[1]) if place[1] else None,
        indenter=indenter if isinstance(indenter, Indenter) else None,
        yaw_deg=angles[0],
        tilt_x_deg=angles[1],
        tilt_y_deg=angles[2],
    )


def _optional(where: str, row: dict[str, str], column: str) -> float:
    text = row.get(column, "").strip()
    return number(where, column, text) if text else 0.0


def _within(where: str, row: dict[str, str], column: str, most: float) -> float:
    value = _optional(where, row, column)
    if abs(value) > most:
        raise ConfigError(
            f"{where}: {column}: found {quoted(row[column])}, expected a number from -{most:g} to {most:g}"
        )
    return value
