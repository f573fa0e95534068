"""A disk whose n-th system call fails, as Python sees it."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest

Way = Literal["EIO", "ENOSPC", "short"]
"""One call fails; from one on nothing more is written; a write takes half, and then likewise."""
CALLS = ("open", "fsync", "replace", "rename", "link", "mkdir", "unlink", "truncate", "pwrite")
GROW = ("io.open", "write", "mkdir", "open", "pwrite")
"""What a full disk refuses; it still renames and removes."""


class FailingDisk:
    """Counts calls that concern `folder`, which is to be patched in, and fails at the n-th."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, number: int, way: Way) -> None:
        self._folder, self._number, self._way = str(folder), number, way
        self._real_open = io.open
        self.count = 0
        for name in CALLS:
            patch.setattr(os, name, self._counted(name, getattr(os, name)))
        patch.setattr(io, "open", self._open)

    @property
    def failed(self) -> bool:
        """Whether the n-th call has come."""
        return self.count >= self._number

    def _counted(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **more: Any) -> Any:
            if not isinstance(given[0], int) and not str(given[0]).startswith(self._folder):
                return real(*given, **more)
            # To wait for the disk, a file or folder is opened like this; to read it, otherwise.
            reads = name == "open" and not given[1] & (os.O_WRONLY | os.O_RDWR)
            if reads and given[1] != os.O_RDONLY:
                return real(*given, **more)
            self.check("read" if reads else name, str(given[0]))
            return real(*given, **more)

        return call

    def check(self, name: str, path: str) -> None:
        """Count a call, and raise what it fails with."""
        self.count += 1
        if self._way == "EIO" and self.count == self._number:
            raise OSError(errno.EIO, os.strerror(errno.EIO), path)
        # A short write has happened in place of the n-th failure.
        beyond = self.count > self._number or self._way == "ENOSPC"
        if self._way != "EIO" and self.failed and beyond and name in GROW:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)

    def write(self, real: Callable[[Any], int], data: Any, path: str) -> int:
        """Write through a stream."""
        self.check("write", path)
        if self._way == "short" and self.count == self._number:
            return real(memoryview(data)[: len(data) // 2])
        return real(data)

    def _open(
        self, file: Any, mode: str = "r", buffering: int = -1, *text: Any, **more: Any
    ) -> Any:
        if not set(mode) & set("wax+") or not str(file).startswith(self._folder):
            return self._real_open(file, mode, buffering, *text, **more)
        self.check("io.open", str(file))
        if "opener" in more:  # a file without a name
            return self._real_open(file, mode, buffering, *text, **more)
        raw = _Stream(file, mode.replace("b", "").replace("t", ""), self)
        if buffering == 0:
            return raw
        buffered = io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, *text, **more)


class _Stream(io.FileIO):
    def __init__(self, file: Any, mode: str, disk: FailingDisk) -> None:
        super().__init__(file, mode)
        self._disk = disk

    def write(self, data: Any) -> int:
        return self._disk.write(super().write, data, str(self.name))
