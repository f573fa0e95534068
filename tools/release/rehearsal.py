#!/usr/bin/env python3
"""Rehearse a release in a throw-away clone: the changelog's number, the tag, every file's name; nothing is published.

::

    .venv/bin/python -m tools.release.rehearsal 1.0.0 [--out FOLDER]

It does what CONTRIBUTING.md tells a maintainer, on a clone of the last commit: give *Unreleased* its number, commit,
tag, build and check the distributions. It prints the version, the files, the names of the Debian packages and what is
still to do in this tree. Without --out it keeps nothing.
"""

from __future__ import annotations

import argparse
import datetime
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tools.release import distributions
from tools.release.package_debian import ARCHITECTURES, RELEASES, file_name
from tools.release.version import version

UNRELEASED = "## [Unreleased]"
PLACEHOLDER = "REPOSITORY_URL"
EXAMPLE = "https://example.org/tacshade-edge"


def rehearse(tree: Path, number: str, out: Path) -> tuple[list[Path], list[str]]:
    """Release the last commit of `tree` as `number` in a clone.

    Returns
    -------
    (list of Path, list of str)
        The distributions, below `out`; what a maintainer still has to do before the tag.

    Raises
    ------
    ValueError
        The changelog has nothing to release, or a file has another version.
    subprocess.CalledProcessError
    """
    todo = []
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder, "clone")
        subprocess.run(("git", "clone", "--quiet", str(tree), str(clone)), check=True)
        project, changelog = clone / "pyproject.toml", clone / "CHANGELOG.md"
        if PLACEHOLDER in (text := project.read_text(encoding="utf-8")):
            todo.append("pyproject.toml: set Repository to the repository's address")
            project.write_text(text.replace(PLACEHOLDER, EXAMPLE), encoding="utf-8")
        text = changelog.read_text(encoding="utf-8")
        if UNRELEASED in text:
            todo.append(f"CHANGELOG.md: give Unreleased the number {number} and its day")
            text = text.replace(UNRELEASED, f"## [{number}] - {datetime.date.today()}")
            changelog.write_text(text, encoding="utf-8")
        if not re.search(rf"^## \[{re.escape(number)}\] - \d{{4}}-\d\d-\d\d\n(?s:.*?)^- ", text, re.MULTILINE):
            raise ValueError(f"CHANGELOG.md: found no changes of {number}")
        git = ("git", "-C", str(clone), "-c", "user.name=rehearsal", "-c", "user.email=rehearsal@localhost")
        subprocess.run((*git, "commit", "--quiet", "--allow-empty", "--all", "-m", f"Release {number}"), check=True)
        subprocess.run((*git, "tag", "-a", "-m", number, f"v{number}"), check=True)
        if (told := version(clone)) != number:
            raise ValueError(f"the tag v{number} gives the version {told}")
        files = distributions.build(clone, out)
    if others := [path.name for path in files if f"-{number}-" not in path.name and f"-{number}.tar" not in path.name]:
        raise ValueError(f"found {', '.join(others)}, expected the version {number}")
    return files, todo


def main() -> int:
    """Rehearse and print."""
    parser = argparse.ArgumentParser(prog="rehearsal.py", description="Rehearse a release in a throw-away clone.")
    parser.add_argument("number", metavar="MAJOR.MINOR.PATCH")
    parser.add_argument("--out", type=Path, help="folder that keeps the distributions")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            files, todo = rehearse(distributions.TREE, args.number, args.out or Path(folder))
        except ValueError as error:
            print(f"rehearsal: {error}", file=sys.stderr)
            return 1
        distributions.check(files)
        print(f"version: {args.number}")
        print(*(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB" for path in files), sep="\n")
    debs = [file_name(args.number, python, machine) for python in RELEASES for machine in ARCHITECTURES]
    print(f"Debian packages of this tag: {', '.join(debs)}")
    print(*(f"to do before the tag: {line}" for line in todo), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
