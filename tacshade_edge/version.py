"""The installed version of the package."""

from __future__ import annotations

from functools import cache


def how_to_install(extra: str) -> str:
    """The command that installs an extra: from the clone, as long as no index has the package."""
    return f"pip install '.[{extra}]' in the clone"


@cache
def installed_version() -> str:
    """The version set at build time (``tools/release/version.py``); ``0+unknown`` in an uninstalled checkout."""
    from importlib import metadata  # takes 10 ms that most commands do not need

    try:
        return metadata.version("tacshade-edge")
    except metadata.PackageNotFoundError:
        return "0+unknown"
