#!/usr/bin/env python3
"""``make dist``: the sdist and wheel of every distribution in this repository,
as an index takes them.

::

    .venv/bin/python -m tools.release.distributions [--out dist]

It builds the last commit, never the working tree, and checks the results with ``twine check
--strict``, which uv fetches. On an index a README has no files beside it: its relative links become
links into the repository.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path, PurePosixPath

from tools.release.version import version

TREE = Path(__file__).resolve().parents[2]
UV = (sys.executable, "-m", "uv")
TWINE = (*UV, "tool", "run", "--quiet", "twine>=6", "check", "--strict")
_LINK = re.compile(
    r"(?P<before>(?P<image>!?)\[(?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*\]\()(?P<target>[^)\s]+)(?=\))"
)
_ATTRIBUTE = re.compile(r"(?P<before>\b(?P<name>src|srcset|href)=\")(?P<target>[^\"]+)(?=\")")
_ELSEWHERE = re.compile(r"[a-z]+:|#")


def projects(tree: Path) -> list[Path]:
    """Folders of the distributions: the tree itself,
    and those right below it that have a pyproject.toml.
    """
    return [tree, *sorted(path.parent for path in tree.glob("*/pyproject.toml"))]


def repository(tree: Path) -> str:
    """The repository's address, from pyproject.toml.

    Raises ValueError: it is none, and no index would take it.
    """
    project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = str(project.get("urls", {}).get("Repository", "none"))
    if not found.startswith("https://"):
        raise ValueError(
            f"pyproject.toml: Repository below [project.urls]: found {found}, "
            "expected an address with https://"
        )
    return found.rstrip("/")


def absolute(text: str, folder: str, address: str, ref: str) -> str:
    """A README (Markdown, HTML for images) of a folder whose relative links lead into the
    repository at a tag.
    """

    def made(found: re.Match[str]) -> str:
        target = found["target"]
        if _ELSEWHERE.match(target):
            return found[0]
        file, mark, anchor = target.partition("#")
        named = found.groupdict()
        kind = "raw" if named.get("image") or named.get("name", "href") != "href" else "blob"
        path = PurePosixPath(folder, file)
        if ".." in path.parts:
            path = PurePosixPath(Path("/", path).resolve().relative_to("/"))
        return f"{found['before']}{address}/{kind}/{ref}/{path}{mark}{anchor}"

    inner = re.sub(
        r"!\[[^\]]*\]\([^)\s]+\)", lambda image: _LINK.sub(made, image[0]), text
    )  # images within links
    return _ATTRIBUTE.sub(made, _LINK.sub(made, inner))


def build(tree: Path, out: Path) -> list[Path]:
    """Build every distribution of the last commit of `tree` into `out`; return the files.

    Raises ValueError (as `repository`) and subprocess.CalledProcessError.
    """
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder, "clone")
        subprocess.run(("git", "clone", "--quiet", str(tree), str(clone)), check=True)
        released, address = version(clone), repository(clone)
        command = ("git", "-C", str(clone), "rev-parse", "HEAD")
        commit = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
        ref = commit if "dev" in released else f"v{released}"
        made = Path(folder, "made")
        for project in projects(clone):
            readme = project / "README.md"
            where = str(project.relative_to(clone))
            readme.write_text(
                absolute(readme.read_text(encoding="utf-8"), where, address, ref), encoding="utf-8"
            )
            words = ("build", "--quiet", "--no-build-isolation", "--out-dir", str(made))
            subprocess.run((*UV, *words, str(project)), check=True)
        return [
            path.replace(out / path.name)
            for path in sorted(made.iterdir())
            if not path.name.startswith(".")
        ]


def check(files: list[Path]) -> None:
    """Raise CalledProcessError if an index would refuse a file or could not render its README."""
    subprocess.run((*TWINE, *map(str, files)), check=True)


def main() -> int:
    """Build and check."""
    parser = argparse.ArgumentParser(
        prog="distributions.py", description="Build every distribution's sdist and wheel."
    )
    parser.add_argument("--out", type=Path, default=TREE / "dist", help="folder")
    args = parser.parse_args()
    try:
        files = build(TREE, args.out)
    except ValueError as error:
        print(f"distributions: {error}", file=sys.stderr)
        return 1
    check(files)
    return 0


if __name__ == "__main__":
    sys.exit(main())
