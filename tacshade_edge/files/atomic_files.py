"""Writes files whole or not at all, and says in one line why a file could not be written."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import shutil
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from tacshade_edge.errors import DeviceError
from tacshade_edge.quoting import quoted
from tacshade_edge.reasons import ReasonCode

FREE_FLOOR_BYTES = 256 * 2**20
"""Free space that recordings and sessions leave on the disk:
a full disk harms more than just them.
"""


@contextlib.contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turn an OSError into a DeviceError that names the file, or `folder` if no file is known."""
    try:
        yield
    except OSError as error:
        where = error.filename or folder
        raise DeviceError(
            f"{where}: cannot write it: {error.strerror or error}", code=ReasonCode.DISK
        ) from None


def is_nearly_full(folder: Path) -> bool:
    """Whether a folder's disk has less free space than `FREE_FLOOR_BYTES`."""
    return shutil.disk_usage(folder).free < FREE_FLOOR_BYTES


def require_free(folder: Path) -> None:
    """Raise DeviceError (DISK_FULL) if the disk of a folder, which need not exist yet,
    is nearly full.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if is_nearly_full(existing):
        found, expected = shutil.disk_usage(existing).free // 2**20, FREE_FLOOR_BYTES // 2**20
        text = f"{existing}: found {found} MiB free on the disk, expected at least {expected} MiB"
        raise DeviceError(text, code=ReasonCode.DISK_FULL)


def free_name(folder: Path) -> Path:
    """A new folder's path in a folder, named by the time in UTC; with ``-2`` and so on if the name
    exists, as on a machine without a clock after each boot.
    """
    name = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
    names = itertools.chain((name,), (f"{name}-{number}" for number in itertools.count(2)))
    return next(path for each in names if not os.path.lexists(path := folder / each))


def part(path: Path) -> Path:
    """The path of an incomplete file. Raises OSError for a path without a name, such as ``/``."""
    if not path.name:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    # In the same folder: between file systems, a rename would copy, and could be cut short.
    return path.with_name(path.name + ".part")


_MOUNTED = (
    "the file itself is a mount and cannot be replaced; mount the folder that contains it instead"
)


def write_whole(path: Path, data: bytes | Iterable[bytes], *, sync: bool = True) -> None:
    """Write a file under a temporary name, then rename it; refuse to replace a device or pipe such
    as ``/dev/null``. A link's target is written, and what is replaced keeps its mode and, where
    that is allowed, its owner. With `sync` it waits until the file and its name are on the disk.

    Of two that write one file at once, the second waits for the first, for at most `WAIT_S`. Raises
    OSError and then leaves nothing behind.
    """
    # A rename would replace the link, and leave the file that it names as it was.
    path = Path(os.path.realpath(path)) if path.is_symlink() else path
    _write(path, data, wait=sync)
    if sync:
        _sync_names(path.parent)


def _write(path: Path, data: bytes | Iterable[bytes], *, wait: bool) -> None:
    """Write a file whole; with `wait` its bytes are on the disk, its name need not be."""
    partial = part(path)
    before: os.stat_result | None = None
    with contextlib.suppress(FileNotFoundError):
        before = path.stat()
        # os.replace would put a file in the place of the device.
        if stat.S_IFMT(before.st_mode) not in (stat.S_IFREG, stat.S_IFDIR):
            raise OSError(errno.EEXIST, "found no regular file", str(path))
    with _alone(partial):
        try:
            with partial.open("wb") as stream:
                if before is not None:
                    _take_over(stream.fileno(), before)
                stream.writelines((data,) if isinstance(data, bytes) else data)
                if wait:
                    # Before the rename, which may reach the disk before the data: after a power
                    # cut, the name would stand for an empty file.
                    stream.flush()
                    os.fsync(stream.fileno())
            os.replace(partial, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
            if error.errno == errno.EBUSY:
                raise OSError(errno.EBUSY, _MOUNTED, str(path)) from None
            raise


WAIT_S = 2.0
_LOOK_AGAIN_S = 0.005
# A file system without locks, as some of a network.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP)


@contextlib.contextmanager
def _alone(partial: Path) -> Iterator[None]:
    """Have an incomplete file, which may be what a process that was killed left, for this writer
    alone until the block ends. Raises OSError, also if another keeps it for `WAIT_S`.
    """
    until_s = time.monotonic() + WAIT_S
    while (descriptor := _locked(partial)) is None:
        if time.monotonic() > until_s:
            found = f"another program has been writing it for {WAIT_S:g} s"
            raise OSError(errno.EAGAIN, found, str(partial))
        time.sleep(_LOOK_AGAIN_S)
    try:
        yield
    finally:
        os.close(descriptor)


def _locked(partial: Path) -> int | None:
    """Open and lock an incomplete file; None if another has it."""
    # Not emptied by this: it may be another's.
    flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor, is_ours = os.open(partial, flags, 0o666), False
    try:
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Between the two calls, another may have finished it, so that it has its final name.
            is_ours = is_named(descriptor, partial)
    except OSError as error:
        is_ours = error.errno in _NO_LOCKS
        if not is_ours:
            raise
    finally:
        if not is_ours:
            os.close(descriptor)
    return descriptor if is_ours else None


def is_named(descriptor: int, path: Path) -> bool:
    """Whether a path names an open regular file."""
    try:
        named = os.stat(path, follow_symlinks=False)
    except FileNotFoundError:
        return False
    own = os.fstat(descriptor)
    return stat.S_ISREG(own.st_mode) and (own.st_dev, own.st_ino) == (named.st_dev, named.st_ino)


def _take_over(descriptor: int, before: os.stat_result) -> None:
    """Give a new file the owner and the mode of the one that it replaces, as far as allowed."""
    if not stat.S_ISREG(before.st_mode):
        return
    now = os.fstat(descriptor)
    with contextlib.suppress(PermissionError):
        if (now.st_uid, now.st_gid) != (before.st_uid, before.st_gid):
            os.fchown(descriptor, before.st_uid, before.st_gid)
    # Last: a change of the owner takes bits away. Some file systems have no modes.
    with contextlib.suppress(PermissionError):
        os.fchmod(descriptor, stat.S_IMODE(before.st_mode))


def write_set(
    folder: Path, files: Mapping[str, bytes | Iterable[bytes]], manifest: str, about: bytes
) -> None:
    """Write files that belong together, and their names, to the disk, all before the first one
    replaces an older one: `manifest` is absent while they are mixed with older ones.

    From then until the new ones are whole, the folder `previous_set` has the older ones, whole too.
    Raises OSError.
    """
    new = [folder / f"{name}.new" for name in (*files, manifest)]
    try:
        for path, data in zip(new, (*files.values(), about), strict=True):
            _write(path, data, wait=True)
        if (folder / manifest).exists():
            _keep(folder, (*files, manifest), manifest)
        # On the disk without the manifest before the first name changes: after a power cut between
        # two renames, its absence shows that the files are mixed.
        (folder / manifest).unlink(missing_ok=True)
        sync(folder)
        *others, last = new
        for path in others:
            os.replace(path, path.with_suffix(""))
        sync(folder)
        os.replace(last, folder / manifest)
        sync(folder)
    except OSError:
        for path in new:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
        raise
    # A rest of it harms nothing.
    shutil.rmtree(previous_set(folder, manifest), ignore_errors=True)


def previous_set(folder: Path, manifest: str) -> Path:
    """Where `write_set` keeps the older files while it replaces them."""
    return folder / f"{Path(manifest).stem}-previous"


def _keep(folder: Path, names: Iterable[str], manifest: str) -> None:
    """Make `previous_set` of those files that are there."""
    kept = previous_set(folder, manifest)
    partial = part(kept)
    for path in (kept, partial):
        shutil.rmtree(path, ignore_errors=True)
    partial.mkdir()
    for name in names:
        with contextlib.suppress(FileNotFoundError):
            try:
                os.link(folder / name, partial / name)
            except PermissionError:  # as on a file system without links
                shutil.copyfile(folder / name, partial / name)
                sync(partial / name)
    sync(partial)
    os.replace(partial, kept)
    sync(folder)


def sync(path: Path) -> None:
    """Wait until a file's bytes, or a folder's names, are on the disk. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


# A folder that may be written but not read, and a file system that syncs no folders.
_NOT_SYNCED = (errno.EACCES, errno.EINVAL)


def _sync_names(folder: Path) -> None:
    try:
        sync(folder)
    except OSError as error:
        if error.errno not in _NOT_SYNCED:
            raise


LOCK_NAME = ".owner"
_OWNER_BYTES_MAX = 200


class FolderLock:
    """A lock that this process holds on a folder, or on a file in it,
    until `release` or its own end, whichever way.

    Raises DeviceError if another process holds it (IN_USE, with its `owner` and process id),
    or it cannot be written.
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
                # The kernel releases it however the process ends: no lock has to be judged stale.
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = (
                    os.pread(self._descriptor, _OWNER_BYTES_MAX, 0).decode(errors="replace").strip()
                )
                kind = "file" if file else "folder"
                self.release()
                raise DeviceError(
                    (
                        f"{folder / file}: in use by {quoted(holder)}, expected a {kind} that no "
                        "other program is using"
                    ),
                    code=ReasonCode.IN_USE,
                ) from None
            except OSError:
                self.release()
                raise
            os.ftruncate(self._descriptor, 0)
            os.pwrite(
                self._descriptor, f"{owner}, process {os.getpid()}\n".encode()[:_OWNER_BYTES_MAX], 0
            )

    def release(self) -> None:
        """Release the lock."""
        os.close(self._descriptor)
