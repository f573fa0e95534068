"""LABELS.csv: what a robot or a person knows of each frame, for ``tacshade-edge evaluate --labels``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.tables.tables import number, read_rows

COLUMNS = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm")


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """An image and what is known of it.

    Attributes
    ----------
    path : Path
    known : mapping of str to float
        Some of `COLUMNS`.
    """

    path: Path
    known: Mapping[str, float]


def read_labels(path: Path, folder: Path) -> list[LabelledImage]:
    """Read the table; a cell is empty where nothing is known.

    Parameters
    ----------
    path : Path
    folder : Path
        Where the images are.

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``, or no line at all.
    """
    labelled = []
    for where, (name, *cells) in read_rows(path, ("image", *COLUMNS), "labels"):
        if not name:
            raise ConfigError(f"{where}: image: found nothing, expected a file of {folder}")
        known = {column: number(where, column, cell) for column, cell in zip(COLUMNS, cells, strict=True) if cell}
        labelled.append(LabelledImage(folder / name, known))
    if not labelled:
        raise ConfigError(f"{path}: found no image, expected a line for each")
    return labelled
