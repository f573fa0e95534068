"""Looks, before long work, whether its result can be written, and keeps others from writing the
same file meanwhile.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from tacshade_edge.errors import DeviceError
from tacshade_edge.files.atomic_files import disk_errors, is_named, part
from tacshade_edge.quoting import escaped
from tacshade_edge.reasons import ReasonCode

WORK_FLOOR_BYTES = 16 * 2**20
"""Free space that long work needs before it begins: a calibration with its images, or a map."""
LOCK_SUFFIX = ".owner"
_OWNER_BYTES_MAX = 2000


def target_of(path: Path) -> Path:
    """The path at which a file is written: of a link, its target."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def check_file(path: Path) -> None:
    """Refuse a file that `write_whole` could not write now. Whatever exists stays as it is.

    Raises DeviceError (a folder, a device or a pipe; no folder to write to; no right to; no space).
    """
    with disk_errors(path):
        path = target_of(path)
        _check_kind(path)
        _check_space(path, path.parent)


def check_folder(folder: Path, names: Iterable[str] = ()) -> None:
    """Refuse a folder that cannot be made, or in which files of these names could not be written.
    Folders that were missing are removed again.

    Raises DeviceError.
    """
    with disk_errors(folder):
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in names:
                _check_kind(target_of(folder / name))
            _check_space(folder, folder)
        finally:
            for path in missing:
                with contextlib.suppress(OSError):
                    path.rmdir()


def _check_kind(path: Path) -> None:
    for each in (path, part(path)):
        try:
            # From Python 3.14 on, `exists` and `is_dir` hide that a name is too long.
            mode = each.stat().st_mode
        except FileNotFoundError:
            continue
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(each))
        if each == path and not stat.S_ISREG(mode):
            raise OSError(errno.EEXIST, "found no regular file", str(path))


def _check_space(path: Path, folder: Path) -> None:
    try:
        # A file without a name: rights, quotas and read-only disks are asked by no other way.
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(b"\0")
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    if (free := shutil.disk_usage(folder).free) < WORK_FLOOR_BYTES:
        expected = f"expected at least {WORK_FLOOR_BYTES >> 20} MiB"
        text = f"{path}: found {free >> 20} MiB free on the disk, {expected}"
        raise DeviceError(text, code=ReasonCode.DISK_FULL)


@contextlib.contextmanager
def one_at_a_time(path: Path, command: str, doing: str) -> Iterator[None]:
    """Keep other processes that ask for the same `path` away until the block ends;
    `command` and `doing` say to them who is there.

    The lock ends with its process, however that ends. Raises DeviceError (IN_USE, or the lock's
    file cannot be written, beside a file and inside a folder).
    """
    # Under each of its names, a file has one lock.
    path = target_of(path)
    lock = path / LOCK_SUFFIX if path.is_dir() else path.with_name(path.name + LOCK_SUFFIX)
    with disk_errors(lock):
        descriptor = _locked(lock, path, command)
    try:
        since = time.strftime("%H:%M")
        owner = f"another {command} (pid {os.getpid()}) is {doing} {path} since {since}"
        with disk_errors(lock):
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, owner.encode(errors="replace")[:_OWNER_BYTES_MAX], 0)
        yield
    finally:
        # While it is locked: who opened it meanwhile sees that it is no longer the named one.
        with contextlib.suppress(OSError):
            lock.unlink()
        os.close(descriptor)


@contextlib.contextmanager
def owned_folder(folder: Path, command: str) -> Iterator[None]:
    """Make a folder, and keep other processes that ask for the same away until the block ends. If
    nothing is in it then, it is removed again.

    Raises DeviceError, as `check_folder` and `one_at_a_time` do.
    """
    check_folder(folder)
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    with disk_errors(folder):
        # First: the lock of a folder lies in it.
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with one_at_a_time(folder, command, "writing"):
            yield
    finally:
        for path in missing:
            with contextlib.suppress(OSError):
                path.rmdir()


def _locked(lock: Path, path: Path, command: str) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    while True:
        descriptor = os.open(lock, flags, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The last owner may have removed it between the two calls.
            if is_named(descriptor, lock):
                return descriptor
        except BlockingIOError:
            owner = os.pread(descriptor, _OWNER_BYTES_MAX, 0).decode(errors="replace").strip()
            os.close(descriptor)
            found = escaped(owner) or f"{path}: another {command} is using it"
            raise DeviceError(f"{found}; wait for its end", code=ReasonCode.IN_USE) from None
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
