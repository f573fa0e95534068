"""One file with what makes a board this one: its settings, and each sensor's calibration,
reference, history, taught objects and maps. Files of passwords and certificates are not in it.
"""

from __future__ import annotations

import contextlib
import os
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from tacshade_edge.calibration.files import ageing_file, objects_file, reference_file
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors, part, sync, write_whole
from tacshade_edge.files.file_kinds import kind_at
from tacshade_edge.files.targets import one_at_a_time
from tacshade_edge.quoting import shown
from tacshade_edge.settings import Document, load_all

SETTINGS = "settings.yaml"
REPLACED = ".replaced"
"""End of the name that a restore gives a file in whose place it puts another."""
_BYTES_MAX = 4 << 30
_BLOCK_BYTES = 1 << 20
_MAPS = "maps"


def back_up(config: Path, out: Path) -> list[str]:
    """Write the backup of the board that these settings describe; return the names in it.

    Raises ConfigError (the settings, `out` exists, or more than a restore takes) and DeviceError
    (IN_USE while another backup writes it).
    """
    files = ((SETTINGS, config), *_files(load_all(config)))
    if sum(path.stat().st_size for _, path in files) > _BYTES_MAX:
        found = f"found more than {_BYTES_MAX >> 30} GiB of calibrations, objects and maps"
        fix = "expected what a restore takes; keep old folders of maps elsewhere"
        raise ConfigError(f"{config}: {found}, {fix}")
    names = []
    # Two would write the same incomplete file, and both results would be damaged.
    with one_at_a_time(out, "backup", "writing"), disk_errors(out):
        if out.exists():
            raise ConfigError(f"{out}: already exists, expected a new name")
        partial = part(out)
        try:
            with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as file:
                # Only the board's owner: a map may show what a robot touched.
                partial.chmod(0o600)
                for name, path in files:
                    file.write(path, name)
                    names.append(name)
            sync(partial)
            os.replace(partial, out)
            sync(out.parent)
        finally:
            partial.unlink(missing_ok=True)
    return names


def restore(backup: Path, config: Path) -> list[Path]:
    """Put back a backup's files where its settings name them, the settings in `config`; a file that
    differs is kept with the end `REPLACED`. Return the files that were written.

    Raises ConfigError (settings), DecodeError (no backup, or damaged) and DeviceError; before
    anything is written, the whole backup has been read.
    """
    with _opened(backup) as file, contextlib.ExitStack() as stack:
        text = file.read(SETTINGS)
        with disk_errors(config):
            config.parent.mkdir(parents=True, exist_ok=True)
        stack.enter_context(one_at_a_time(config, "backup", "restoring"))
        documents = _documents(text, config)
        targets = [(name, _target(backup, name, documents)) for name in file.namelist()[1:]]
        written = [path for name, path in targets if _put(file, name, path)]
        # Last: settings must not name files that are not there yet.
        return [*written, config] if _put(file, SETTINGS, config) else written


def _roles(document: Document) -> dict[str, Path]:
    """A sensor's single files by their names in a backup."""
    calibration = Path(document.settings.calibration)
    return {
        "calibration.npz": calibration,
        "reference.npz": reference_file.path_beside(calibration),
        "objects.npz": objects_file.path_beside(calibration),
        "ageing.npz": ageing_file.path_beside(calibration),
    }


def _files(documents: Sequence[Document]) -> Iterator[tuple[str, Path]]:
    """Name in the backup and path of each file that is there."""
    for document in documents:
        sensor_id = document.settings.sensor_id
        for role, path in _roles(document).items():
            if path.is_file():
                yield f"{sensor_id}/{role}", path
        folder = Path(document.settings.stitching.folder)
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.is_symlink():
                yield f"{sensor_id}/{_MAPS}/{path.relative_to(folder).as_posix()}", path


@contextlib.contextmanager
def _opened(backup: Path) -> Iterator[zipfile.ZipFile]:
    """A whole and undamaged backup."""
    expected = "expected a file that `tacshade-edge backup` wrote"
    try:
        with zipfile.ZipFile(backup) as file:
            infos = file.infolist()
            if not infos or infos[0].filename != SETTINGS:
                found = kind_at(backup) or f"no {SETTINGS} at its start"
                raise DecodeError(f"{shown(backup)}: found {found}, {expected}")
            if sum(each.file_size for each in infos) > _BYTES_MAX:
                raise DecodeError(
                    f"{shown(backup)}: found more than {_BYTES_MAX >> 30} GiB, {expected}"
                )
            if (damaged := file.testzip()) is not None:
                raise DecodeError(f"{shown(backup)}: {shown(damaged)} in it is damaged, {expected}")
            yield file
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError) as error:
        found = f"found {kind}" if (kind := kind_at(backup)) else str(error)
        raise DecodeError(f"{shown(backup)}: {found}, {expected}") from None
    except OSError as error:
        if error.filename != str(backup):
            raise
        raise DecodeError(f"{shown(backup)}: {error.strerror}, {expected}") from None


def _documents(text: bytes, config: Path) -> tuple[Document, ...]:
    # Beside their later place, since relative paths start there.
    beside = config.with_name(f"{config.name}.restored")
    with disk_errors(beside):
        try:
            write_whole(beside, text, sync=False)
            return load_all(beside)
        finally:
            beside.unlink(missing_ok=True)


def _target(backup: Path, name: str, documents: Sequence[Document]) -> Path:
    """Where a file of the backup belongs. Raises DecodeError for any other name."""
    sensor_id, *rest = PurePosixPath(name).parts
    for document in documents:
        if document.settings.sensor_id != sensor_id:
            continue
        if len(rest) == 1 and rest[0] in (roles := _roles(document)):
            return roles[rest[0]]
        # Nothing in a backup may lie outside its folder.
        if len(rest) > 1 and rest[0] == _MAPS and ".." not in rest:
            return Path(document.settings.stitching.folder, *rest[1:])
    raise DecodeError(
        f"{shown(backup)}: found {shown(name)}, expected a file of one of the sensors in its "
        f"{SETTINGS}"
    )


def _put(file: zipfile.ZipFile, name: str, path: Path) -> bool:
    """Write a file unless it is there already; whether it was written."""
    with disk_errors(path):
        if path.exists():
            if _is_same(file, name, path):
                return False
            os.replace(path, path.with_name(path.name + REPLACED))
        path.parent.mkdir(parents=True, exist_ok=True)
        with file.open(name) as stream:
            write_whole(path, iter(lambda: stream.read(_BLOCK_BYTES), b""))
        _give_to_owner(path)
    return True


def _is_same(file: zipfile.ZipFile, name: str, path: Path) -> bool:
    if path.stat().st_size != file.getinfo(name).file_size:
        return False
    crc = 0
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            crc = zlib.crc32(block, crc)
    return crc == file.getinfo(name).CRC


def _give_to_owner(path: Path) -> None:
    """As root, give a file to the owner of its folder, so that the service can write it."""
    if os.geteuid() == 0:
        owner = path.parent.stat()
        os.chown(path, owner.st_uid, owner.st_gid)
