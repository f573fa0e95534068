"""``make lock``: pin a board's packages to the newest wheels that pyproject allows, and list their contents.

::

    python -m tools.release.lock            # systemd/requirements.lock, then docs/reference/bill.cdx.json
    python -m tools.release.lock --bill     # only the list, from the existing lock

This needs uv, which resolves packages for all machines together and installs them for machines other than this one.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from tools.release.bill import bill

ROOT = Path(__file__).resolve().parents[2]
LOCK = ROOT / "systemd/requirements.lock"
BILL = ROOT / "docs/reference/bill.cdx.json"
MACHINES = ("x86_64", "aarch64")
PYTHONS = ("3.11", "3.13")
HEADER = """\
# What systemd/environment.sh installs: wheels alone, for every machine and Python that is supported.
# Made by `make lock`; never edited.
"""
UV = (sys.executable, "-m", "uv", "pip", "--quiet")


def lock() -> None:
    """Write the lock with the packages of the program, of its page, and of its build."""
    builds = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    words = ["--universal", "--python-version", PYTHONS[0], "--extra", "dashboard", "--upgrade", "--generate-hashes"]
    words += ["--only-binary", ":all:", "--emit-build-options", "--no-header", "--no-annotate"]
    command = [*UV, "compile", str(ROOT / "pyproject.toml"), "-", *words]
    done = subprocess.run(command, input="\n".join(builds), stdout=subprocess.PIPE, text=True, check=True)
    LOCK.write_text(HEADER + done.stdout)


def list_what_is_in_it() -> None:
    """Install the lock for each machine and Python, which also shows that all have wheels, and write the list."""
    with tempfile.TemporaryDirectory() as folder:
        found: dict[str, Path] = {}
        for machine in MACHINES:
            for python in PYTHONS:
                name = f"{machine} {python}"
                target = found[name] = Path(folder, name)
                words = ["--python-platform", f"{machine}-manylinux_2_28", "--python-version", python]
                words += ["--target", str(target), "--require-hashes", "--no-deps", "-r", str(LOCK)]
                subprocess.run([*UV, "install", *words], check=True)
        BILL.write_text(bill(found, ROOT))


if __name__ == "__main__":
    if "--bill" not in sys.argv:
        lock()
    list_what_is_in_it()
