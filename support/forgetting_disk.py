"""A disk whose power is cut: it keeps what was synced, and forgets the rest."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

import pytest

Way = Literal["nothing", "names"]
"""Of what was not synced: nothing is kept; or the names are, of files without their content, as
file systems do that write them first.
"""


Names = dict[int, dict[str, tuple[int, bool]]]
"""The names in each folder, by its inode: the inode of each, and whether it is a folder."""


class PowerCutError(BaseException):
    """What ends the program as its power is cut; no error of the disk."""


def names_in(folder: Path) -> dict[str, tuple[int, bool]]:
    """The names in a folder."""
    return {each.name: (each.stat().st_ino, each.is_dir()) for each in folder.iterdir()}


class ForgettingDisk:
    """Follows what is synced below `folder`, and cuts the power at the n-th sync, before it.

    What lies there at first is on the disk. Files are known by their inodes, as a name may be
    another file's a moment later.
    """

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, number: int) -> None:
        self._folder, self._number, self.syncs = folder, number, 0
        self._held = ExitStack()
        self._content: dict[int, bytes] = {}
        self._names: Names = {}
        self._seen: Names = {}
        for at in (folder, *folder.rglob("*")):
            self._keep(at)
        patch.setattr(os, "fsync", self._synced)

    def __enter__(self) -> ForgettingDisk:
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    @property
    def cut(self) -> bool:
        """Whether the power was cut."""
        return self.syncs >= self._number

    def _synced(self, file: Any) -> None:
        descriptor = file if isinstance(file, int) else file.fileno()
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        if not path.is_relative_to(self._folder):
            return
        self.syncs += 1
        if self.cut:
            self._seen = self._named()
            raise PowerCutError
        self._keep(path)

    def _keep(self, path: Path) -> None:
        if path.is_dir():
            self._names[path.stat().st_ino] = names_in(path)
        elif path.exists():
            stream = path.open("rb")
            self._content[os.fstat(stream.fileno()).st_ino] = stream.read()
            # While it is open, no other file gets its inode.
            self._held.enter_context(stream)

    def _named(self) -> Names:
        folders = [self._folder, *(each for each in self._folder.rglob("*") if each.is_dir())]
        return {each.stat().st_ino: names_in(each) for each in folders}

    def after(self, to: Path, way: Way) -> Path:
        """Write what is there after the power is back into a new folder; return it."""
        names = self._names if way == "nothing" else self._seen or self._named()
        self._write(self._folder.stat().st_ino, to, names)
        return to

    def _write(self, folder: int, to: Path, names: Names) -> None:
        to.mkdir()
        for name, (inode, is_folder) in names.get(folder, {}).items():
            if is_folder:
                self._write(inode, to / name, names)
            else:
                (to / name).write_bytes(self._content.get(inode, b""))
