"""Exports the cloud of every frame in contact as a PLY file."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.storage.atomic_files import sync
from tacshade_edge.storage.exports.new_place import NewPlace
from tacshade_edge.storage.meshes.ply import ply
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction


class PlyExport:
    """A folder of ``SEQ.ply`` files: points of the skin in contact in mm, sensor frame, with their object's number."""

    def __init__(self, folder: Path) -> None:
        self._place = NewPlace(folder)
        with self._place.writing():
            self._place.partial.mkdir()

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write the cloud of a frame in contact."""
        if not result.contact:
            return
        comment = f"millimetres, sensor frame, t_ns {result.t_ns}"
        with self._place.writing():
            path = self._place.partial / f"{recorded.frame.seq:06d}.ply"
            path.write_bytes(ply(result.cloud.points_mm, comment, result.cloud.labels))

    def finish(self) -> None:
        """Complete the folder and move it to its final name."""
        with self._place.writing():
            for path in self._place.partial.iterdir():
                sync(path)
        self._place.take()

    def discard(self) -> None:
        """Remove the unfinished folder."""
        self._place.discard()
