"""The package index: pip itself reads it and checks the hashes."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from tools.ci.first_map import serve
from tools.release import index

pytestmark = pytest.mark.skipif(find_spec("pip") is None, reason="pip is not installed")


def wheel(folder: Path, name: str, requires: str = "") -> Path:
    """One that has nothing in it."""
    made = folder / f"{name}-1.0-py3-none-any.whl"
    needs = f"Requires-Dist: {requires}\n" if requires else ""
    with zipfile.ZipFile(made, "w") as archive:
        about = f"{name}-1.0.dist-info"
        archive.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{needs}")
        archive.writestr(
            f"{about}/WHEEL", "Wheel-Version: 1.0\nGenerator: a\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr(f"{about}/RECORD", "")
    return made


def download(folder: Path, out: Path) -> subprocess.CompletedProcess[str]:
    server = serve(folder)
    address = f"http://127.0.0.1:{server.server_port}/simple/"
    words = ["-m", "pip", "--isolated", "download", "--no-cache-dir", "--disable-pip-version-check", "--retries", "0"]
    command = [sys.executable, *words, "--index-url", address, "-d", str(out), "first-one"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False)
    finally:
        server.shutdown()
        server.server_close()


def test_pip_finds_what_a_package_needs(tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    made = [wheel(tmp_path / "made", "First_One", "second"), wheel(tmp_path / "made", "second")]
    index.lay_out(made, tmp_path / "served")
    done = download(tmp_path / "served", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(path.name for path in made)


def test_pip_refuses_what_was_changed(tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    index.lay_out([wheel(tmp_path / "made", "first_one")], tmp_path / "served")
    (tmp_path / "served/files/first_one-1.0-py3-none-any.whl").write_bytes(b"other")
    done = download(tmp_path / "served", tmp_path / "out")
    assert done.returncode != 0
    assert "DO NOT MATCH THE HASHES" in done.stderr
