"""MCAP, the container that robotics tools share;
the package `mcap` (extra ``mcap``) is imported only when needed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import by_number, is_hidden
from tacshade_edge.quoting import shown
from tacshade_edge.recording.frame_table import table_in
from tacshade_edge.regular_files import open_regular
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


def mcap_frames(path: Path, topic: str | None = None) -> McapFrames:
    """The frames of an MCAP file or of a folder's MCAP files, from the only topic of images or the
    given one.

    Raises ConfigError, also if the extra is missing.
    """
    require_mcap()
    from tacshade_edge.recording.mcap.stored_frames import McapFrames

    return McapFrames(mcap_files(path), topic)


_BAGS: Final = {b"#ROSBAG": "a bag of ROS 1", b"SQLite format 3": "a bag of ROS 2 in SQLite"}
_BAG_SUFFIXES: Final = (".bag", ".db3")


def how_to_convert(path: Path) -> str:
    """What a bag, or a folder with one, is instead of MCAP, and how to convert it; empty if it is
    none.
    """
    bag = path
    if path.is_dir():
        inside = (file for file in path.iterdir() if file.suffix.lower() in _BAG_SUFFIXES)
        bag = next((file for file in inside if not is_hidden(file)), path)
    try:
        with open_regular(bag, sys.maxsize) as stream:
            head = stream.read(max(map(len, _BAGS)))
    except OSError:
        return ""
    found = next((kind for magic, kind in _BAGS.items() if head.startswith(magic)), "")
    # The description of a bag of ROS 2 lies beside it.
    source = bag.parent if "SQLite" in found else bag
    command = f"rosbags-convert --src {shown(source)} --dst {shown(bag.stem)} --dst-storage mcap"
    return f"found {found}, expected MCAP; to convert it: {command}" if found else ""


def require_mcap() -> None:
    """Raise ConfigError if the extra ``mcap`` is not installed."""
    try:
        import foxglove_schemas_protobuf  # noqa: F401
        import mcap.reader  # noqa: F401
    except ImportError as error:
        found = f"found no package {error.name}, which MCAP files need"
        raise ConfigError(f"{found}; to install it: {how_to_install('mcap')}") from None
