#!/usr/bin/env python3
"""``make apt KEY=...``: lay out the Debian packages of ``dist/`` as a signed apt repository, for any web server.

::

    python3 -m tools.release.apt_repository --key FINGERPRINT [--debs dist] [--out dist/apt]

Packages of Debian 12 go to the suite ``bookworm``, those of 13 to ``trixie``; ``tacshade-edge.asc`` is the public key.
Running it again adds packages: what lies in the pool stays. Only Debian's dpkg-deb and GnuPG are needed.
"""

from __future__ import annotations

import argparse
import email.utils
import gzip
import hashlib
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tools.release.package_debian import ARCHITECTURES, TREE

SUITES = {"deb12": "bookworm", "deb13": "trixie"}
"""Suites by the end of a package's version (`package_debian.debian_version`)."""
POOL = "pool/main/t/tacshade-edge"
KEY_FILE = "tacshade-edge.asc"


def lay_out(debs: Sequence[Path], out: Path, key: str) -> None:
    """Add packages to the repository at `out` and sign it.

    Parameters
    ----------
    debs : sequence of Path
    out : Path
        A folder, empty or a repository.
    key : str
        Which of GnuPG's keys signs.

    Raises
    ------
    ValueError
        A package's version names no suite.
    subprocess.CalledProcessError
    """
    (out / POOL).mkdir(parents=True, exist_ok=True)
    for deb in debs:
        shutil.copy(deb, out / POOL)
    pool = sorted((out / POOL).glob("*.deb"))
    for path in pool:
        if suite_of(path) is None:
            raise ValueError(f"{path.name}: found no +deb12 or +deb13 in its version")
    for suite in SUITES.values():
        _write_suite(out, suite, [path for path in pool if suite_of(path) == suite], key)
    exported = subprocess.run(("gpg", "--batch", "--armor", "--export", key), check=True, capture_output=True).stdout
    (out / KEY_FILE).write_bytes(exported)


def suite_of(deb: Path) -> str | None:
    """The suite that a package is for, by its file's name."""
    return SUITES.get(deb.name.split("_")[1].rpartition("+")[2])


def stanza(deb: Path, root: Path) -> str:
    """A package's lines in ``Packages``."""
    control = subprocess.run(("dpkg-deb", "--field", str(deb)), check=True, capture_output=True, text=True).stdout
    content = deb.read_bytes()
    where = f"Filename: {deb.relative_to(root)}\nSize: {len(content)}\nSHA256: {hashlib.sha256(content).hexdigest()}\n"
    return control.rstrip("\n") + "\n" + where


def _write_suite(out: Path, suite: str, debs: Sequence[Path], key: str) -> None:
    folder = out / "dists" / suite
    shutil.rmtree(folder, ignore_errors=True)
    files: dict[str, bytes] = {}
    for architecture in ARCHITECTURES.values():
        packages = "\n".join(stanza(deb, out) for deb in debs if deb.name.endswith(f"_{architecture}.deb")).encode()
        name = f"main/binary-{architecture}/Packages"
        files |= {name: packages, f"{name}.gz": gzip.compress(packages, mtime=0)}
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    sums = [f" {hashlib.sha256(content).hexdigest()} {len(content)} {name}" for name, content in files.items()]
    release = {
        "Origin": "tacshade-edge",
        "Label": "tacshade-edge",
        "Suite": suite,
        "Codename": suite,
        "Date": email.utils.formatdate(time.time(), usegmt=True),
        "Architectures": " ".join(ARCHITECTURES.values()),
        "Components": "main",
        "SHA256": "\n" + "\n".join(sums),
    }
    text = "".join(f"{name}: {value}\n" if name != "SHA256" else f"{name}:{value}\n" for name, value in release.items())
    (folder / "Release").write_text(text)
    gpg = ("gpg", "--batch", "--yes", "--local-user", key, "--digest-algo", "SHA512")
    sign = (("--clearsign", "InRelease"), ("--armor --detach-sign", "Release.gpg"))
    for how, name in sign:
        command = (*gpg, "--output", str(folder / name), *how.split(), str(folder / "Release"))
        subprocess.run(command, check=True, capture_output=True)


def main() -> int:
    """Lay out the repository that the command line requests."""
    parser = argparse.ArgumentParser(prog="apt_repository.py", description="Lay out a signed apt repository.")
    parser.add_argument("--key", required=True, help="fingerprint or address of the key that signs")
    parser.add_argument("--debs", type=Path, default=TREE / "dist", help="folder with the packages")
    parser.add_argument("--out", type=Path, default=TREE / "dist/apt", help="folder of the repository")
    args = parser.parse_args()
    debs = sorted(args.debs.glob("*.deb"))
    if not debs:
        print(f"apt_repository: {args.debs}: found no package, expected those of make deb", file=sys.stderr)
        return 1
    lay_out(debs, args.out, args.key)
    print(*(f"{path.relative_to(args.out)}" for path in sorted(args.out.rglob("*")) if path.is_file()), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
