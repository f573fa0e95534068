"""The folder that ``tacshade-edge capture`` fills and ``calibrate`` and ``run`` read."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.storage.atomic_files import disk_errors, write_whole
from tacshade_edge.storage.images import png, read_image
from tacshade_edge.storage.tables.presses import BALL, HEADER, MORE, press_rows
from tacshade_edge.storage.tables.tables import number, read_rows
from tacshade_edge.types import U8

SENSOR, SETTINGS, PRESSES, INDENTERS = "SENSOR.yaml", "config.yaml", "PRESSES.csv", "INDENTERS.yaml"
REFERENCES = "reference_*.png"


@dataclass(frozen=True, slots=True)
class Stated:
    """A press as a person states it: the columns of PRESSES.csv except the image, as text."""

    columns: tuple[str, ...]

    def row(self) -> dict[str, str]:
        """The cells by column."""
        return dict(zip((*HEADER[1:], *MORE), self.columns, strict=False))

    def __str__(self) -> str:
        indenter, radius_mm, depth_mm, x_mm, y_mm, *more = self.columns
        size = f" of {radius_mm} mm" if radius_mm else ""
        place = f" at x {x_mm}, y {y_mm} mm" if x_mm else ""
        rest = "".join(f", {name} {text}" for name, text in zip(MORE, more, strict=False) if text)
        return f"{indenter}{size}, {depth_mm} mm deep{place}{rest}"


@dataclass(frozen=True, slots=True)
class TakenPress:
    """A row of PRESSES.csv."""

    image: str
    stated: Stated

    @property
    def number(self) -> int:
        """The number in the image's name; 0 if `capture` did not name the image."""
        digits = self.image.removeprefix("press_").removesuffix(".png")
        return int(digits) if digits.isascii() and digits.isdecimal() else 0


def stated(where: str, columns: Sequence[str], names: Collection[str], skin_radius_mm: float) -> Stated:
    """Check a press's ``indenter, radius_mm, depth_mm, x_mm, y_mm`` and either all columns of `MORE` or none.

    `names` are indenters in addition to the ball. Raises ConfigError, ``WHERE: column: found …, expected …``.
    """
    indenter, radius_text, depth_text, x_text, y_text, *more = columns
    if indenter != BALL and indenter not in names:
        raise ConfigError(f"{where}: indenter: found {indenter!r}, expected {' or '.join((BALL, *sorted(names)))}")
    if indenter != BALL and radius_text:
        raise ConfigError(
            f"{where}: radius_mm: found {radius_text!r}, expected nothing, because {INDENTERS} states the radius"
        )
    if indenter == BALL and not number(where, "radius_mm", radius_text) > 0:
        raise ConfigError(f"{where}: radius_mm: found {radius_text}, expected a number above 0")
    if not 0 < number(where, "depth_mm", depth_text) < skin_radius_mm:
        expected = f"a number above 0 and below the skin's radius of {skin_radius_mm:g} mm"
        raise ConfigError(f"{where}: depth_mm: found {depth_text}, expected {expected}")
    if (x_text == "") != (y_text == ""):
        raise ConfigError(f"{where}: x_mm, y_mm: found only one value, expected both or neither")
    if x_text and not number(where, "x_mm", x_text) ** 2 + number(where, "y_mm", y_text) ** 2 < skin_radius_mm**2:
        expected = f"a place within the skin's radius of {skin_radius_mm:g} mm"
        raise ConfigError(f"{where}: x_mm, y_mm: found {x_text}, {y_text} mm, expected {expected}")
    for name, text in zip(MORE, more, strict=False):
        if text:
            number(where, name, text)
    return Stated(tuple(columns))


def read_plan(path: Path, names: Collection[str], skin_radius_mm: float) -> tuple[Stated, ...]:
    """Read a plan of presses from a table like PRESSES.csv; its images are ignored. Raises ConfigError."""
    rows, _ = press_rows(path)
    if not rows:
        raise ConfigError(f"{path}: found no press, expected at least one")
    cells = [(where, [row.get(column, "").strip() for column in (*HEADER, *MORE)]) for where, row in rows]
    return tuple(stated(where, _columns(row[1:]), names, skin_radius_mm) for where, row in cells)


def _columns(cells: Sequence[str]) -> tuple[str, ...]:
    """The cells, without the columns of `MORE` if all of those are empty."""
    least = len(HEADER) - 1
    return tuple(cells) if any(cells[least:]) else tuple(cells[:least])


class CaptureFolder:
    """The folder; each change is complete on the disk when the call returns, or it raises DeviceError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sensor, self.settings = path / SENSOR, path / SETTINGS
        self.presses, self.indenters = path / PRESSES, path / INDENTERS

    def make(self) -> None:
        """Make the folder if it does not exist."""
        with disk_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)

    def write(self, path: Path, text: str) -> None:
        """Write a text file."""
        with disk_errors(self.path):
            write_whole(path, text.encode())

    def references(self) -> list[U8]:
        """The reference images that were taken. Raises ConfigError."""
        try:
            return [read_image(path) for path in sorted(self.path.glob(REFERENCES))]
        except DecodeError as error:
            raise ConfigError(f"{error}; delete this image to take the references again") from None

    def write_references(self, images: Sequence[U8]) -> None:
        """Replace the reference images; an interruption leaves too few images but never a mixture of two sets."""
        with disk_errors(self.path):
            for path in self.path.glob(REFERENCES):
                path.unlink()
            for k, image in enumerate(images):
                write_whole(self.path / f"reference_{k:02d}.png", png(image))

    def picture(self, press: TakenPress) -> U8:
        """The image of a press. Raises ConfigError."""
        try:
            return read_image(self.path / press.image)
        except DecodeError as error:
            raise ConfigError(str(error)) from None

    def taken(self) -> list[TakenPress]:
        """The rows of PRESSES.csv; none without a table. Raises ConfigError."""
        if not self.presses.exists():
            return []
        taken = []
        for where, (image, *columns) in read_rows(self.presses, HEADER, "presses", more=MORE):
            if not (self.path / image).is_file():
                raise ConfigError(f"{where}: image: found no file {image}, expected one in the table's folder")
            taken.append(TakenPress(image, Stated(_columns(columns))))
        return taken

    def add(self, taken: Sequence[TakenPress], image: U8, press: Stated) -> TakenPress:
        """Append a press: write its image first, then the table."""
        added = TakenPress(f"press_{next_number(taken):03d}.png", press)
        with disk_errors(self.path):
            write_whole(self.path / added.image, png(image))
            write_whole(self.presses, _table([*taken, added]))
        return added

    def remove(self, taken: Sequence[TakenPress], removed: TakenPress) -> None:
        """Remove a press from the table, then delete its image."""
        with disk_errors(self.path):
            write_whole(self.presses, _table([one for one in taken if one is not removed]))
            (self.path / removed.image).unlink()


def next_number(taken: Sequence[TakenPress]) -> int:
    """The number of the next press."""
    return max((one.number for one in taken), default=0) + 1


def _table(rows: Sequence[TakenPress]) -> bytes:
    least = len(HEADER) - 1
    wide = any(len(row.stated.columns) > least for row in rows)
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEADER + MORE if wide else HEADER)
    for row in rows:
        empty = ("",) * (len(MORE) if wide and len(row.stated.columns) == least else 0)
        writer.writerow((row.image, *row.stated.columns, *empty))
    return stream.getvalue().encode()
