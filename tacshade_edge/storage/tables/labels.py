"""LABELS.csv: known quantities of each frame, from a robot or person, for ``calibrate`` and ``evaluate --labels``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.regular_files import named_file
from tacshade_edge.storage.tables.tables import number, read_columns
from tacshade_edge.types import QUANTITIES


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """An image and its known quantities.

    Attributes
    ----------
    path : Path
    known : mapping of str to float
        Some of `types.QUANTITIES`.
    where : str
        ``FILE:LINE``.
    group : str
        The same for all images of one press; empty if not stated.
    """

    path: Path
    known: Mapping[str, float]
    where: str = ""
    group: str = ""


def read_labels(path: Path, folder: Path) -> list[LabelledImage]:
    """Read the table: columns in any order, an empty cell for an unknown quantity.

    Parameters
    ----------
    path : Path
    folder : Path
        The folder of the images.

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``, no quantity, or no row at all.
    """
    table = read_columns(path, ("image",), (*QUANTITIES, "group"), "labels")
    if table.unknown:
        expected = f"image, group and any of {', '.join(QUANTITIES)}"
        raise ConfigError(f"{path}:1: {table.unknown[0]}: found an unknown column, expected {expected}")
    labelled = []
    for where, cells in table.rows:
        if not (name := cells["image"]):
            raise ConfigError(f"{where}: image: found nothing, expected the name of a file in {folder}")
        numbers = table.with_points(cells)
        known = {column: number(where, column, numbers[column]) for column in QUANTITIES if numbers.get(column)}
        labelled.append(LabelledImage(named_file(folder, name), known, where, cells.get("group", "")))
    if not labelled:
        raise ConfigError(f"{path}: found no rows, expected one per image")
    if not any(row.known for row in labelled):
        raise ConfigError(f"{path}:1: found no quantity, expected at least one of {', '.join(QUANTITIES)}")
    return labelled
