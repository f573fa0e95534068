"""Where an export grows until it is whole: a file or a folder beside its place."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.atomic_files import disk_errors, part, require_free, sync


class NewPlace:
    """A name that is free, and its ``.part``, which is removed where an earlier one was left.

    Attributes
    ----------
    partial : Path

    Raises
    ------
    ConfigError
        Something is there.
    DeviceError
        The disk is down to the floor, or cannot be written.
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
        """Rename."""
        with self.writing():
            self.partial.rename(self.path)
            sync(self.path.parent)

    def discard(self) -> None:
        """Remove the ``.part``."""
        if self.partial.is_dir():
            shutil.rmtree(self.partial, ignore_errors=True)
        else:
            self.partial.unlink(missing_ok=True)
