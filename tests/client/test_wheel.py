"""The wheels of the client and of the LeRobot camera."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from email import message_from_bytes
from importlib.util import find_spec
from pathlib import Path

import pytest

from tools.release.version import version
from tools.testbed.patience import patience

ROOT = Path(__file__).parents[2]
BYTES_MAX = 60_000
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("hatchling") is None, reason="hatchling is not installed"),
]


def built(tree: Path, folder: Path) -> Path:
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(words, cwd=tree, check=True, capture_output=True, timeout=patience(120))
    (made,) = folder.iterdir()
    return made


def test_it_is_small_and_owns_no_file_of_the_daemons_wheel(tmp_path: Path) -> None:
    wheel = built(ROOT / "client", tmp_path / "client")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = message_from_bytes(
            archive.read(next(name for name in names if name.endswith("/METADATA")))
        )
        assert not any(
            b"tacshade_edge" in archive.read(name) for name in names if name.endswith(".py")
        )
    print(f"{wheel.name}: {wheel.stat().st_size} bytes")
    assert wheel.stat().st_size < BYTES_MAX
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"tacshade_client"}
    assert {"tacshade_client/py.typed", "tacshade_client/wire/wire_format.py"} <= set(names)
    assert (about["Version"], about["License-Expression"]) == (version(), "MIT")
    needs = [re.split("[<>]", need)[0] for need in about.get_all("Requires-Dist", [])]
    assert needs == ["msgspec", "numpy", "paho-mqtt"]


def test_the_camera_for_lerobot_has_the_name_that_lerobot_looks_for(tmp_path: Path) -> None:
    wheel = built(ROOT / "client_lerobot", tmp_path / "made")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = message_from_bytes(
            archive.read(next(name for name in names if name.endswith("/METADATA")))
        )
    assert (about["Name"], about["License-Expression"]) == ("lerobot_camera_tacshade", "MIT")
    assert about.get_all("Requires-Dist") == ["tacshade-client"]
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {
        "lerobot_camera_tacshade"
    }
