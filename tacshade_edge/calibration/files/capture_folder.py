"""The folder that ``tacshade-edge capture`` fills and ``calibrate`` and ``run`` read."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.calibration.files.press_table import (
    HEADER,
    MORE,
    Stated,
    press_rows,
    stated_columns,
)
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors, part, sync, write_whole
from tacshade_edge.files.images import by_number, number_in, png, read_image
from tacshade_edge.files.tables import csv_bytes, require_rows
from tacshade_edge.types import U8

SENSOR, SETTINGS, PRESSES, INDENTERS = "SENSOR.yaml", "config.yaml", "PRESSES.csv", "INDENTERS.yaml"
REFERENCES = "reference_*.png"
REST, TOUCHES = "rest", "touches"


@dataclass(frozen=True, slots=True)
class TakenPress:
    """A row of PRESSES.csv."""

    image: str
    stated: Stated

    @property
    def number(self) -> int:
        """The number in the image's name; 0 if `capture` did not name the image."""
        return number_in(self.image, "press")


class CaptureFolder:
    """The folder; each change is complete on the disk when the call returns,
    or it raises DeviceError.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sensor, self.settings = path / SENSOR, path / SETTINGS
        self.presses, self.indenters = path / PRESSES, path / INDENTERS
        self.rest, self.touches = path / REST, path / TOUCHES

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
            return [read_image(path) for path in sorted(self.path.glob(REFERENCES), key=by_number)]
        except DecodeError as error:
            raise ConfigError(f"{error}; delete this image to take the references again") from None

    def write_references(self, images: Sequence[U8]) -> None:
        """Replace the reference images; an interruption leaves too few images but never a mixture
        of two sets.
        """
        with disk_errors(self.path):
            for path in self.path.glob(REFERENCES):
                path.unlink()
            for k, image in enumerate(images):
                write_whole(self.path / f"reference_{k:02d}.png", png(image))

    def rest_pictures(self) -> list[Path]:
        """The pictures of the untouched sensor, in order."""
        return sorted(self.rest.glob("rest_*.png"), key=by_number)

    def touch_pictures(self) -> list[Path]:
        """The pictures of touches without a label, in order."""
        return sorted(self.touches.glob("touch_*.png"), key=by_number)

    def picture(self, path: Path) -> U8:
        """One of these pictures. Raises ConfigError."""
        try:
            return read_image(path)
        except DecodeError as error:
            raise ConfigError(str(error)) from None

    def begin_rest(self) -> None:
        """Begin to record the untouched sensor; what an interrupted recording left is removed."""
        with disk_errors(self.path):
            shutil.rmtree(part(self.rest), ignore_errors=True)
            part(self.rest).mkdir()

    def add_rest(self, number: int, image: U8) -> None:
        """Add a picture to the recording that was begun."""
        with disk_errors(self.path):
            # Synced once at the end, because a sync holds up the frames.
            write_whole(part(self.rest) / f"rest_{number:03d}.png", png(image), sync=False)

    def finish_rest(self) -> None:
        """Put the recording in the place of an earlier one."""
        partial = part(self.rest)
        with disk_errors(self.path):
            for path in partial.iterdir():
                sync(path)
            # Its own names, too: a folder that is renamed keeps no others.
            sync(partial)
            self.forget_rest()
            partial.rename(self.rest)
            sync(self.path)

    def add_touch(self, image: U8) -> None:
        """Add a picture of a touch."""
        number = len(self.touch_pictures()) + 1
        with disk_errors(self.path):
            self.touches.mkdir(exist_ok=True)
            sync(self.path)
            write_whole(self.touches / f"touch_{number:02d}.png", png(image))

    def forget_rest(self) -> None:
        """Remove the recording of the untouched sensor."""
        shutil.rmtree(self.rest, ignore_errors=True)

    def forget_touches(self) -> None:
        """Remove the touches without a label."""
        shutil.rmtree(self.touches, ignore_errors=True)

    def taken(self) -> list[TakenPress]:
        """The rows of PRESSES.csv; none without a table. Raises ConfigError."""
        if not self.presses.exists():
            return []
        rows, notes = press_rows(self.presses)
        if notes:
            raise ConfigError(f"{notes[0]}; delete these columns, which `capture` would not keep")
        taken = []
        for where, row in rows:
            if not (self.path / row["image"]).is_file():
                raise ConfigError(
                    f"{where}: image: found no file {row['image']}, "
                    "expected one in the table's folder"
                )
            taken.append(TakenPress(row["image"], Stated(stated_columns(row))))
        return taken

    def add(self, taken: Sequence[TakenPress], image: U8, press: Stated) -> TakenPress:
        """Append a press: write its image first, then the table."""
        added = TakenPress(f"press_{next_number(taken):03d}.png", press)
        require_rows(self.presses, len(taken) + 1)
        with disk_errors(self.path):
            write_whole(self.path / added.image, png(image))
            # The table last: a row without its image would refuse the folder, an image without a
            # row is ignored.
            write_whole(self.presses, _table([*taken, added]))
        return added

    def remove(self, taken: Sequence[TakenPress], removed: TakenPress) -> None:
        """Remove a press from the table, then delete its image."""
        with disk_errors(self.path):
            write_whole(self.presses, _table([one for one in taken if one is not removed]))
            # After the table, for the same reason.
            (self.path / removed.image).unlink()


def next_number(taken: Sequence[TakenPress]) -> int:
    """The number of the next press."""
    return max((one.number for one in taken), default=0) + 1


def _table(rows: Sequence[TakenPress]) -> bytes:
    columns = [row.stated.columns for row in rows]
    # Only if some press needs the columns: a person reads and edits this file.
    header = HEADER + MORE if max(map(len, columns), default=0) >= len(HEADER) else HEADER
    filled = (one + ("",) * (len(header) - 1 - len(one)) for one in columns)
    return csv_bytes(header, [(row.image, *cells) for row, cells in zip(rows, filled, strict=True)])
