"""The version that a build gets, which pyproject.toml asks here: the tag's, and beyond it the next one's development.

`git describe` tells both; in an sdist PKG-INFO does, in an archive that git made, ``archive_version.txt``. Where a part
of the tree is built elsewhere, as for an image, who sends it there tells by ``TACSHADE_EDGE_VERSION``.
"""

from __future__ import annotations

import email
import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNKNOWN = "0+unknown"
"""Nothing tells: a copy of the files alone. The daemon says the same where it runs without being installed."""

_DESCRIBED = re.compile(r"v(\d+)\.(\d+)\.(\d+)(?:-(\d+)-g([0-9a-f]+))?")


def version(root: Path = ROOT) -> str:
    """The version of the tree at `root`."""
    if told := os.environ.get("TACSHADE_EDGE_VERSION"):
        return told
    if (about := root / "PKG-INFO").is_file():
        return str(email.message_from_string(about.read_text(encoding="utf-8"))["Version"])
    if (root / ".git").exists():  # else git would describe whatever repository lies around it
        if described := _git(root, "describe", "--tags", "--long", "--match", "v[0-9]*", "--exclude", "*-*"):
            return version_of(described)
        if commits := _git(root, "rev-list", "--count", "HEAD"):  # before the first release
            return f"0.1.0.dev{commits}+g{_git(root, 'rev-parse', '--short', 'HEAD')}"
        return UNKNOWN
    archived = root / "tools/release/archive_version.txt"
    return version_of(archived.read_text(encoding="utf-8").strip()) if archived.is_file() else UNKNOWN


def version_of(described: str) -> str:
    """From what `git describe` says: ``v1.2.3`` is 1.2.3, ``v1.2.3-4-gabc`` 1.2.4.dev4+gabc."""
    found = _DESCRIBED.fullmatch(described)
    if found is None:
        return UNKNOWN
    major, minor, patch, distance, commit = found.groups()
    if distance in (None, "0"):
        return f"{major}.{minor}.{patch}"
    return f"{major}.{minor}.{int(patch) + 1}.dev{distance}+g{commit}"


def _git(root: Path, *words: str) -> str:
    """What it says; nothing where it is missing or fails. A tree of another's is the user's choice, who builds it."""
    command = ["git", "-c", f"safe.directory={root}", "-C", str(root), *words]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


if __name__ == "__main__":
    print(version())
