"""LABELS.csv: known quantities of each frame, from a robot or person, as ``calibrate`` and
``evaluate --labels`` read it and ``capture --labels`` writes it with its images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.images import number_in, png
from tacshade_edge.files.tables import csv_bytes, number, read_columns, require_rows
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.types import QUANTITIES, U8


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """An image and its known quantities (of `types.QUANTITIES`);
    `where` is ``FILE:LINE``, `group` names its press.
    """

    path: Path
    known: Mapping[str, float]
    where: str = ""
    group: str = ""


def read_labels(path: Path, folder: Path) -> list[LabelledImage]:
    """Read the table, whose images are in `folder`; an empty cell is an unknown quantity.

    Raises ConfigError for a mistake, no quantity, or no row at all.
    """
    rows, unknown = read_columns(path, ("image",), (*QUANTITIES, "group"), "labels")
    if unknown:
        expected = f"image, group and any of {', '.join(QUANTITIES)}"
        raise ConfigError(f"{path}:1: {unknown[0]}: found an unknown column, expected {expected}")
    labelled = []
    for where, cells in rows:
        if not (name := cells["image"]):
            raise ConfigError(
                f"{where}: image: found nothing, expected the name of a file in {folder}"
            )
        known = {
            column: number(where, column, cells[column]) for column in QUANTITIES if cells[column]
        }
        labelled.append(LabelledImage(named_file(folder, name), known, where, cells["group"]))
    if not labelled:
        raise ConfigError(f"{path}: found no rows, expected one per image")
    if not any(row.known for row in labelled):
        raise ConfigError(
            f"{path}:1: found no quantity, expected at least one of {', '.join(QUANTITIES)}"
        )
    return labelled


LABELS = "LABELS.csv"


@dataclass(frozen=True, slots=True)
class LabelRow:
    """A row: an image of the folder, its known quantities, its press's number,
    and its time if this run took it.
    """

    image: str
    known: Mapping[str, float]
    group: str
    t_ns: int | None = None


class LabelFolder:
    """The folder; each change is complete on the disk when the call returns,
    or it raises DeviceError.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._number = max(
            (number_in(one.name, "label") for one in path.glob("label_*.png")), default=0
        )

    @property
    def table(self) -> Path:
        """The path of LABELS.csv."""
        return self._path / LABELS

    def rows(self) -> list[LabelRow]:
        """The rows of earlier runs; none without a table. Raises ConfigError."""
        if not self.table.exists():
            return []
        labelled = read_labels(self.table, self._path)
        # `capture` deletes images that are undone, so none may lie elsewhere.
        folder = self._path.resolve()
        for one in labelled:
            if not (one.path.is_file() and one.path.resolve().is_relative_to(folder)):
                expected = "expected a file in the table's folder"
                raise ConfigError(
                    f"{one.where}: image: found no file {shown(one.path)} in it, {expected}"
                )
        return [
            LabelRow(str(one.path.resolve().relative_to(folder)), one.known, one.group)
            for one in labelled
        ]

    def add_image(self, image: U8) -> str:
        """Write an image and return its name."""
        self._number += 1
        name = f"label_{self._number:05d}.png"
        with disk_errors(self._path):
            write_whole(self._path / name, png(image))
        return name

    def write(self, rows: Sequence[LabelRow], removed: Sequence[LabelRow] = ()) -> None:
        """Write the table, or delete it if it has no labels,
        then delete the images of removed rows.

        Raises DeviceError, too, for more rows than are read again.
        """
        require_rows(self.table, len(rows))
        columns = [name for name in QUANTITIES if any(name in row.known for row in rows)]
        cells = [
            [f"{row.known[name]:.4f}" if name in row.known else "" for name in columns]
            for row in rows
        ]
        table = [(row.image, *known, row.group) for row, known in zip(rows, cells, strict=True)]
        with disk_errors(self._path):
            if columns:
                write_whole(self.table, csv_bytes(("image", *columns, "group"), table))
            else:
                self.table.unlink(missing_ok=True)
            for row in removed:
                (self._path / row.image).unlink(missing_ok=True)
