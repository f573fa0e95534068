"""The wheels that the lock names, so that an installation needs no network."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

LOCK = Path(__file__).parents[2] / "systemd/requirements.lock"


def fetch(folder: Path) -> Path:
    """Into a folder, for the Python that runs; skips the test where they are out of reach."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--require-hashes", "--no-deps", "-d", str(folder)]
    done = subprocess.run([*command, "-r", str(LOCK)], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"pip cannot fetch the program's packages here: {done.stderr.strip()[-300:]}")
    return folder
