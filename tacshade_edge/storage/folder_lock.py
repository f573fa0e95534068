"""Locks a folder, or a file in it, for one process; the kernel releases the lock however the process ends."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from tacshade_edge.errors import DeviceError
from tacshade_edge.quoting import quoted
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.atomic_files import disk_errors

LOCK_NAME = ".owner"
_OWNER_BYTES_MAX = 200


class FolderLock:
    """A lock that this process holds on a folder, or on a file in it, until `release` or its own end.

    Others who want it see the name of the `owner` with this process's id. Raises DeviceError if another process holds
    it (IN_USE, with its name), or it cannot be written.
    """

    def __init__(self, folder: Path, owner: str, *, file: str = "") -> None:
        path = folder / f"{file}{LOCK_NAME}"
        with disk_errors(folder):
            if not file:
                folder.mkdir(parents=True, exist_ok=True)
            # Never deleted: a lock on an unlinked file keeps nobody out.
            self._descriptor = os.open(
                path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644
            )
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = os.pread(self._descriptor, _OWNER_BYTES_MAX, 0).decode(errors="replace").strip()
                kind = "file" if file else "folder"
                self.release()
                raise DeviceError(
                    f"{folder / file}: in use by {quoted(holder)}, expected a {kind} that no other program is using",
                    code=ReasonCode.IN_USE,
                ) from None
            except OSError:
                self.release()
                raise
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, f"{owner}, process {os.getpid()}\n".encode()[:_OWNER_BYTES_MAX], 0)

    def release(self) -> None:
        """Release the lock."""
        os.close(self._descriptor)
