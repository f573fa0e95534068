"""A release: sdist, the wheel that is built of it, and what the wheel alone can do in an environment of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import venv
import zipfile
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed

from tacshade_edge.storage.calibration import calibration_file
from tools.release.version import version
from tools.testbed.patience import patience

ROOT = Path(__file__).parents[1]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("hatchling") is None, reason="hatchling is not installed"),
    pytest.mark.skipif(find_spec("pip") is None, reason="pip is not installed"),
]


def built(tree: Path, kind: str, folder: Path) -> Path:
    """What the build backend makes of a tree, as pip would ask it to."""
    words = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(words, cwd=tree, check=True, capture_output=True, timeout=patience(120))
    (made,) = folder.iterdir()
    return made


def installed(wheel: Path, folder: Path) -> Path:
    """The command, of the wheel alone in an environment that sees this one's packages: nothing is downloaded."""
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    reported = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    packages = Path(subprocess.run(reported, check=True, capture_output=True, text=True).stdout.strip())
    (packages / "others.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    # Not over what this environment has installed, which is another's.
    words = ["install", "--quiet", "--no-index", "--no-deps", "--ignore-installed", "--disable-pip-version-check"]
    subprocess.run([python, "-m", "pip", *words, wheel], check=True, env=clean(), timeout=patience(120))
    return folder / "bin" / "tacshade-edge"


def clean() -> dict[str, str]:
    """Without what leads Python to a checkout."""
    return {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}


def test_the_wheel_works_out_of_any_checkout(tmp_path: Path) -> None:
    sdist = built(ROOT, "sdist", tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (tree,) = (tmp_path / "unpacked").iterdir()
    wheel = built(tree, "wheel", tmp_path / "wheel")
    assert wheel.name.split("-")[1] == version() == sdist.name.removesuffix(".tar.gz").split("-")[1]
    names = zipfile.ZipFile(wheel).namelist()
    assert {"tacshade_edge/py.typed", "tacshade_edge/inference/weights/fast.onnx"} <= set(names)
    assert {name.split("/")[0].split("-")[0] for name in names} == {"tacshade_edge"}

    command = installed(wheel, tmp_path / "environment")

    def run(*words: str | Path) -> str:
        done = subprocess.run(
            [command, *words],
            cwd=tmp_path,
            env=clean(),
            capture_output=True,
            text=True,
            timeout=patience(120),
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert run("--version") == f"tacshade-edge {version()}\n"
    calibration_file.save(tmp_path / "cal.npz", calibrated())
    cv2.imwrite(str(tmp_path / "press.png"), pressed("ball", 2.0).image)
    run("reconstruct", "--calibration", "cal.npz", "--out", "out", "press.png")
    with np.load(tmp_path / "out" / "press.npz") as result:
        assert np.nanmax(result["height_mm"]) == pytest.approx(2.0, rel=0.2)
