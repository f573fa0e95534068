"""The version of what is installed."""

from __future__ import annotations

from functools import cache


def how_to_install(extra: str) -> str:
    """The command that adds an extra: of the clone, while no index has the package."""
    return f"pip install '.[{extra}]' in the clone"


@cache
def installed_version() -> str:
    """As it was built (``tools/release/version.py``); of a checkout that is not installed nothing is known."""
    from importlib import metadata  # 10 ms that most commands do without

    try:
        return metadata.version("tacshade-edge")
    except metadata.PackageNotFoundError:
        return "0+unknown"
