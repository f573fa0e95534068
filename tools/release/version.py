"""The version of a build, for pyproject.toml: the tag's version,
or after the tag a development version of the next.

The version comes from `git describe`, in an sdist from PKG-INFO, and in an archive that git made
from ``archive_version.txt``. If another place builds part of the tree, such as an image, its caller
sets ``TACSHADE_EDGE_VERSION``.
"""

from __future__ import annotations

import email
import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNKNOWN = "0+unknown"
"""The version of a bare copy of the files.

A daemon that runs without being installed reports the same.
"""

_DESCRIBED = re.compile(r"v(\d+)\.(\d+)\.(\d+)(?:-(\d+)-g([0-9a-f]+))?")


def version(root: Path = ROOT) -> str:
    """Find the version of the tree at `root`."""
    if reported := os.environ.get("TACSHADE_EDGE_VERSION"):
        return reported
    if (about := root / "PKG-INFO").is_file():
        return str(email.message_from_string(about.read_text(encoding="utf-8"))["Version"])
    if (root / ".git").exists():  # otherwise git would describe a repository around the tree
        if described := _git(
            root, "describe", "--tags", "--long", "--match", "v[0-9]*", "--exclude", "*-*"
        ):
            return version_of(described)
        if commits := _git(root, "rev-list", "--count", "HEAD"):  # before the first release
            return f"0.1.0.dev{commits}+g{_git(root, 'rev-parse', '--short', 'HEAD')}"
        return UNKNOWN
    archived = root / "tools/release/archive_version.txt"
    return (
        version_of(archived.read_text(encoding="utf-8").strip()) if archived.is_file() else UNKNOWN
    )


def version_of(described: str) -> str:
    """Convert the output of `git describe`: ``v1.2.3`` gives 1.2.3,
    ``v1.2.3-4-gabc`` gives 1.2.4.dev4+gabc.
    """
    found = _DESCRIBED.fullmatch(described)
    if found is None:
        return UNKNOWN
    major, minor, patch, distance, commit = found.groups()
    if distance in (None, "0"):
        return f"{major}.{minor}.{patch}"
    return f"{major}.{minor}.{int(patch) + 1}.dev{distance}+g{commit}"


def _git(root: Path, *words: str) -> str:
    """Run git and return its output; an empty string if git is missing or fails.

    `safe.directory` accepts a tree that another user owns, because the user has chosen to build it.
    """
    command = ["git", "-c", f"safe.directory={root}", "-C", str(root), *words]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


if __name__ == "__main__":
    print(version())
