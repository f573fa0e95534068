"""Finished steps of a fit in a folder, so that an interrupted fit goes on; workers exchange frames there, too."""

from __future__ import annotations

import contextlib
import io
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.fitting.twin import Frames
from tacshade_edge.storage.atomic_files import disk_errors, write_whole
from tacshade_edge.storage.npz import read_arrays
from tacshade_edge.types import F32

BYTES_MAX = 1 << 28


class Steps:
    """The steps of one fit. Files of other fits are removed, what else lies in the folder stays. `folder`: made if it
    is not there. `digest`: of everything that the steps depend on. Raises DeviceError (the folder cannot be written).
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder, self._own = folder, f"fit-{digest[:16]}-"
        with disk_errors(folder.parent):
            folder.mkdir(exist_ok=True)
            for path in folder.glob("fit-*.npz"):
                if not path.name.startswith(self._own):
                    path.unlink()

    def has(self, name: str) -> bool:
        """Whether a step is finished."""
        return self._path(name).exists()

    def save_frames(self, name: str, frames: Frames) -> None:
        """Keep a dome's frames. Raises DeviceError."""
        plain = {field.name: getattr(frames, field.name) for field in fields(Frames)}
        ways = {f"{what}.{way}": each for what in ("reference", "white") for way, each in plain.pop(what).items()}
        self._save(name, plain | ways)

    def frames(self, name: str) -> Frames:
        """A dome's frames. Raises DecodeError for a damaged file, which is removed."""
        made: dict[str, Any] = {"reference": {}, "white": {}}
        for key, each in self._load(name).items():
            what, _, way = key.partition(".")
            if way:
                made[what][way] = each
            else:
                made[what] = each
        return Frames(**made)

    def save_weights(self, name: str, weights: F32) -> None:
        """Keep a network's weights. Raises DeviceError."""
        self._save(name, {"weights": weights})

    def weights(self, name: str) -> F32:
        """A network's weights. Raises DecodeError for a damaged file, which is removed."""
        weights: F32 = self._load(name)["weights"]
        return weights

    def remove(self) -> None:
        """Remove the files, and the folder if nothing else lies there."""
        for path in self._folder.glob(f"{self._own}*.npz"):
            path.unlink()
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def _path(self, name: str) -> Path:
        return self._folder / f"{self._own}{name}.npz"

    def _save(self, name: str, arrays: dict[str, Any]) -> None:
        file = io.BytesIO()
        np.savez(file, **arrays)
        with disk_errors(self._folder):
            write_whole(self._path(name), file.getvalue(), sync=False)

    def _load(self, name: str) -> dict[str, Any]:
        path = self._path(name)
        try:
            return {key: each.copy() for key, each in read_arrays(path, BYTES_MAX).items()}  # PyTorch wants to own it
        except DecodeError:
            path.unlink()
            raise
