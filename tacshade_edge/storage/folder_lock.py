"""A folder, or a file in it, with one owner: the kernel gives the lock back when the process ends, however it ends."""

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
    """A folder that is this process's until `release`, or its end.

    Parameters
    ----------
    folder : Path
        Made if it is not there, unless a file of it is meant.
    owner : str
        Said to others who want the folder, with this process's id.
    file : str, optional
        Of the folder's files this one alone is owned.

    Raises
    ------
    DeviceError
        IN_USE, with who holds it; or it cannot be written.
    """

    def __init__(self, folder: Path, owner: str, *, file: str = "") -> None:
        path = folder / f"{file}{LOCK_NAME}"
        with disk_errors(folder):
            if not file:
                folder.mkdir(parents=True, exist_ok=True)
            # Never deleted: a lock on a file that lost its name keeps nobody out.
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
                    f"{folder / file}: in use by {quoted(holder)}, expected a {kind} that nothing else uses",
                    code=ReasonCode.IN_USE,
                ) from None
            except OSError:
                self.release()
                raise
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, f"{owner}, process {os.getpid()}\n".encode()[:_OWNER_BYTES_MAX], 0)

    def release(self) -> None:
        """Let others have it."""
        os.close(self._descriptor)
