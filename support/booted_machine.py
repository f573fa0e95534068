"""Boots systemd over a throw-away copy of this machine (tools/rig/boot_systemd.sh),
and the wheels that it installs.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from support.patience import patience

CHECKOUT = Path(__file__).parents[1]


def cannot_boot() -> str:
    if os.getuid() != 0:
        return "booting systemd needs root"
    if shutil.which("systemd-nspawn") is None:
        return "systemd-container is not installed"
    return ""


def seen_there(folder: Path, scenario: str, python: str, *options: str) -> dict[str, Any]:
    """What a script of tests/service saw; it has `folder` as /payload,
    and the Python at the path `python` there.
    """
    parts = {
        f"tests/service/{scenario}": scenario,
        **{
            f"support/{name}": f"support/{name}"
            for name in ("__init__.py", "booted_service.py", "patience.py")
        },
    }
    for path, there in parts.items():
        (folder / there).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(CHECKOUT / path, folder / there)
    (folder / "scenario").write_text(
        f"#!/bin/bash\nexec {python} /payload/{scenario} {Path(python).name}\n"
    )
    (folder / "scenario").chmod(0o755)
    limit = os.environ | {"LIMIT_S": f"{patience(120):.0f}"}
    command = [str(CHECKOUT / "tools/rig/boot_systemd.sh"), str(folder), *options]
    done = subprocess.run(command, env=limit, capture_output=True, text=True, check=False)
    if done.returncode == 125:
        pytest.skip(f"systemd cannot be booted here: {(done.stdout + done.stderr).strip()[-300:]}")
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stdout)
    result: dict[str, Any] = json.loads((folder / "seen.json").read_text())
    return result


LOCK = Path(__file__).parents[1] / "systemd/requirements.lock"


def fetch(folder: Path) -> Path:
    """Into a folder, for the Python that runs; skips the test where they are out of reach."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--require-hashes",
        "--no-deps",
        "-d",
        str(folder),
    ]
    done = subprocess.run([*command, "-r", str(LOCK)], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"pip cannot fetch the program's packages here: {done.stderr.strip()[-300:]}")
    return folder
