"""``make lock``: pins what a board is given to the newest wheels that pyproject allows, and lists what is in them.

::

    python -m tools.release.lock            # systemd/requirements.lock, then docs/reference/bill.cdx.json
    python -m tools.release.lock --bill     # the list alone, of the lock as it is

Needs uv, which resolves for all machines at once and installs for others than this one.
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
    """Write the lock: the program's packages, those of its page, and what builds it."""
    builds = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    words = ["--universal", "--python-version", PYTHONS[0], "--extra", "dashboard", "--upgrade", "--generate-hashes"]
    words += ["--only-binary", ":all:", "--emit-build-options", "--no-header", "--no-annotate"]
    command = [*UV, "compile", str(ROOT / "pyproject.toml"), "-", *words]
    done = subprocess.run(command, input="\n".join(builds), stdout=subprocess.PIPE, text=True, check=True)
    LOCK.write_text(HEADER + done.stdout)


def list_what_is_in_it() -> None:
    """Install the lock for each machine and Python, which shows too that there are wheels for all."""
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
