"""A package index of files (PEP 503), as pip reads it from any web server."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from collections.abc import Iterable
from html import escape
from pathlib import Path

from packaging.utils import canonicalize_name, parse_sdist_filename, parse_wheel_filename

from tools.release.package_debian import LOCK, RELEASES


def lay_out(files: Iterable[Path], out: Path) -> None:
    """Write ``out/simple`` over copies of wheels and sdists in ``out/files``."""
    (out / "files").mkdir(parents=True, exist_ok=True)
    pages: dict[str, list[str]] = {}
    for file in sorted(files):
        if file.parent != out / "files":
            shutil.copy(file, out / "files")
        sha256 = hashlib.sha256(file.read_bytes()).hexdigest()
        link = f'<a href="../../files/{escape(file.name)}#sha256={sha256}">{escape(file.name)}</a><br>'
        pages.setdefault(name_of(file), []).append(link)
    for name, links in {**pages, "": [f'<a href="{name}/">{name}</a><br>' for name in pages]}.items():
        page = out / "simple" / name / "index.html"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text("<!DOCTYPE html>\n" + "\n".join(links) + "\n", encoding="utf-8")


def name_of(file: Path) -> str:
    """The distribution's normalised name in an index."""
    name = (parse_wheel_filename if file.suffix == ".whl" else parse_sdist_filename)(file.name)[0]
    return str(canonicalize_name(name))


def fetch_locked(folder: Path, python: str) -> None:
    """Fetch the lock's wheels into a folder, for Debian's Python of that version on x86-64."""
    assert python in RELEASES
    platforms = [word for glibc in (28, 27, 24, 17) for word in ("--platform", f"manylinux_2_{glibc}_x86_64")]
    words = [
        "download",
        "--quiet",
        "--disable-pip-version-check",
        "--require-hashes",
        "--no-deps",
        "--only-binary=:all:",
    ]
    words += ["--python-version", python, *platforms, "--platform", "manylinux2014_x86_64", "-d", str(folder)]
    subprocess.run([sys.executable, "-m", "pip", *words, "-r", str(LOCK)], check=True)
