"""MCAP, the container that robotics tools share. The package `mcap` (extra ``mcap``) is imported where one is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.tables.frame_table import table_in
from tacshade_edge.version import how_to_install

if TYPE_CHECKING:
    from tacshade_edge.storage.recording.mcap.frames import McapFrames

_SUFFIXES = (".mcap", ".mcap.part")


def is_mcap(path: Path) -> bool:
    """By its name; a folder by what it has in place of a table of frames."""
    return bool(mcap_files(path))


def mcap_files(path: Path) -> list[Path]:
    """The file itself, or those of a folder in the order of the numbers in their names; none where it is no MCAP."""
    if not path.is_dir():
        return [path] if path.name.lower().endswith(_SUFFIXES) else []
    if table_in(path) is not None:
        return []
    files = [file for file in path.iterdir() if file.name.lower().endswith(_SUFFIXES)]
    return sorted(files, key=lambda file: [int(t) if t.isdecimal() else t for t in re.split(r"(\d+)", file.name)])


def mcap_frames(path: Path) -> McapFrames:
    """The frames in an MCAP file, or in those of a folder. Raises ConfigError, also where the extra is missing."""
    require_mcap()
    from tacshade_edge.storage.recording.mcap.frames import McapFrames

    return McapFrames(mcap_files(path))


def require_mcap() -> None:
    """Raise ConfigError where the extra ``mcap`` is not installed."""
    try:
        import foxglove_schemas_protobuf  # noqa: F401
        import mcap.reader  # noqa: F401
    except ImportError as error:
        found = f"found no package {error.name}, which MCAP needs"
        raise ConfigError(f"{found}; to install it: {how_to_install('mcap')}") from None
