"""The temporary file or folder in which an export grows until it is complete."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.atomic_files import disk_errors, part, require_free, sync


class NewPlace:
    """An unused name and its ``.part``; a leftover ``.part`` is removed.

    Attributes
    ----------
    partial : Path

    Raises
    ------
    ConfigError
        The name exists already.
    DeviceError
        The disk is nearly full (`require_free`), or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        if path.exists():
            found = f"{path}: already exists, expected a new name (--out)"
            raise ConfigError(found, code=ReasonCode.NAME_TAKEN)
        self.path, self.partial = path, part(path)
        with self.writing():
            path.parent.mkdir(parents=True, exist_ok=True)
            self.discard()
        require_free(path.parent)

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Turn an OSError into a DeviceError."""
        with disk_errors(self.path):
            yield

    def take(self) -> None:
        """Rename the ``.part`` to the final name."""
        with self.writing():
            self.partial.rename(self.path)
            sync(self.path.parent)

    def discard(self) -> None:
        """Remove the ``.part``."""
        if self.partial.is_dir():
            shutil.rmtree(self.partial, ignore_errors=True)
        else:
            self.partial.unlink(missing_ok=True)
