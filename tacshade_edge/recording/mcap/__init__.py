"""MCAP, the container that robotics tools share;
the package `mcap` (extra ``mcap``) is imported only when needed.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import by_number, is_hidden
from tacshade_edge.recording.frame_table import table_in
from tacshade_edge.version import how_to_install

if TYPE_CHECKING:
    from tacshade_edge.recording.mcap.stored_frames import McapFrames

# A writer that died, or still writes, leaves the second.
_SUFFIXES = (".mcap", ".mcap.part")


def is_mcap(path: Path) -> bool:
    """Whether a file's name says MCAP, or a folder has MCAP files instead of a table of frames."""
    return bool(mcap_files(path))


def mcap_files(path: Path) -> list[Path]:
    """The file itself, or a folder's files in the order of the numbers in their names;
    empty if it is not MCAP.
    """
    if not path.is_dir():
        return [path] if path.name.lower().endswith(_SUFFIXES) else []
    if table_in(path) is not None:
        return []
    # Recorders number their files: 1000.mcap comes after 999.mcap.
    files = (
        file
        for file in path.iterdir()
        if file.name.lower().endswith(_SUFFIXES) and not is_hidden(file)
    )
    return sorted(files, key=by_number)


def mcap_frames(path: Path) -> McapFrames:
    """The frames of an MCAP file or of a folder's MCAP files.

    Raises ConfigError, also if the extra is missing.
    """
    require_mcap()
    from tacshade_edge.recording.mcap.stored_frames import McapFrames

    return McapFrames(mcap_files(path))


def require_mcap() -> None:
    """Raise ConfigError if the extra ``mcap`` is not installed."""
    try:
        import foxglove_schemas_protobuf  # noqa: F401
        import mcap.reader  # noqa: F401
    except ImportError as error:
        found = f"found no package {error.name}, which MCAP files need"
        raise ConfigError(f"{found}; to install it: {how_to_install('mcap')}") from None
