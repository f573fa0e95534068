"""What users install as tacshade-client: built from the checkout, and run without tacshade_edge."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

from support.patience import patience

ROOT = Path(__file__).parents[1]
# -S: the checkout's own installation is not seen, only what lies in the same folder.
ALONE = (sys.executable, "-I", "-S", "-c")
_BEGIN = """
import runpy, sys
*sys.path[len(sys.path):], program = sys.argv[1:4]
sys.argv = sys.argv[3:]
runpy.run_path(program, run_name="__main__")
"""


def built(tree: Path, folder: Path, kind: str = "wheel") -> Path:
    """Build a distribution of a project's folder into another, as its only file."""
    words = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(words, cwd=tree, check=True, capture_output=True, timeout=patience(120))
    (made,) = folder.iterdir()
    return made


def unpacked(wheel: Path, folder: Path) -> Path:
    """Install a wheel of Python files into a folder."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def command(client: Path, program: Path, *words: str) -> list[str]:
    """Start a program in a Python that has only what the client requires, and the client."""
    packages = sysconfig.get_path("purelib")
    return [*ALONE, _BEGIN, str(client), packages, str(program), *words]
