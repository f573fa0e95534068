"""The installed version of the package."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

PACKAGED = "/opt/tacshade-edge"
"""Where Debian's package, and the service's own script, have the program."""
DPKG_LIST = Path("/var/lib/dpkg/info/tacshade-edge.list")


def how_to_install(extra: str) -> str:
    """The command that installs an extra: from the clone, as long as no index has the package.
    Debian's package takes none.
    """
    if sys.prefix == PACKAGED and DPKG_LIST.exists():
        return (
            f"use a PC whose installation has the extra {extra} (README.md, Get it), as the Debian "
            "package takes none"
        )
    # PyPI's PyTorch brings 3 GB for GPUs.
    index = "https://download.pytorch.org/whl/cpu"
    first = f"pip install torch --index-url {index}, then " if extra == "fit" else ""
    return f"{first}pip install '.[{extra}]' in the clone"


@cache
def installed_version() -> str:
    """The version set at build time (``tools/release/version.py``);
    ``0+unknown`` in an uninstalled checkout.
    """
    # Takes 10 ms, which most commands do not need.
    from importlib import metadata

    try:
        return metadata.version("tacshade-edge")
    except metadata.PackageNotFoundError:
        return "0+unknown"
