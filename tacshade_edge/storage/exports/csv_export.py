"""The numbers of every frame as CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from tacshade_edge.storage.atomic_files import sync
from tacshade_edge.storage.exports.new_place import NewPlace
from tacshade_edge.storage.exports.numbers import frame_numbers
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction


class CsvExport:
    """A CSV file with a row per frame and empty cells for missing values; `touch_names` are a touch's quantities."""

    def __init__(self, path: Path, touch_names: Sequence[str]) -> None:
        self._touch_names = touch_names
        self._place = NewPlace(path)
        with self._place.writing():
            self._stream: TextIO = self._place.partial.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._stream, lineterminator="\n")
        self._frames = 0

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write a row."""
        numbers = frame_numbers(recorded, result, self._touch_names)
        with self._place.writing():
            if self._frames == 0:
                self._writer.writerow(numbers)
            self._writer.writerow("" if value is None else value for value in numbers.values())
        self._frames += 1

    def finish(self) -> None:
        """Complete the file and move it to its final name."""
        with self._place.writing():
            self._stream.close()
            sync(self._place.partial)
        self._place.take()

    def discard(self) -> None:
        """Remove the unfinished file."""
        self._stream.close()
        self._place.discard()
