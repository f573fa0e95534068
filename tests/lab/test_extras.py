"""The laboratory: what commands need beyond it they name in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from support.sensor_files import write_files
from tacshade_edge.cli import EXIT_CONFIG, main

ROOT = Path(__file__).parents[2]
CLUSTER = ["--cluster", "tcp://127.0.0.1:8786"]
HIDDEN = [
    "torch",
    "numba",
    "matplotlib",
    "websockets",
    "iotcore",
    "dask",
    "distributed",
    "foxglove",
    "mcap",
    "shtab",
]


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return write_files(tmp_path_factory.mktemp("sensor"))


def refused(words: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    assert main(words) == EXIT_CONFIG
    (line,) = capfd.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize("package", ["torch", "numba"])
def test_a_fit_names_its_extra(
    package: str,
    sensor: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for each in ("torch", "numba"):
        monkeypatch.setitem(sys.modules, each, sys.modules[__name__])
    monkeypatch.setitem(sys.modules, package, None)
    line = refused(["calibrate", *sensor, "--fit", "--out", str(tmp_path / "cal.npz")], capfd)
    assert f"--fit: the package {package} is not installed; to install it: pip install" in line
    assert line.endswith("then pip install '.[fit]' in the clone")


@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (["simulate", "--pad", "PAD", "--out", "OUT", *CLUSTER], "dask", "cluster"),
        (["evaluate", *CLUSTER], "dask", "cluster"),
        (["tradeoff", *CLUSTER], "distributed", "cluster"),
        (["tradeoff", "--calibration", "cal.npz"], "numba", "fit"),
        (["demo"], "websockets", "demo"),
    ],
)
def test_a_command_names_the_extra_that_it_needs(
    words: list[str],
    package: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    assert refused(words, capfd).endswith(f"pip install '.[{extra}]' in the clone")
    assert not list(tmp_path.iterdir()), "it says so before any work"


@pytest.mark.slow  # it starts an interpreter
def test_no_command_needs_an_extra_before_it_runs() -> None:
    names = sorted(path.stem for path in (ROOT / "tacshade_edge/cli/commands").glob("[a-z]*.py"))
    lines = [
        "import importlib, sys",
        f"sys.modules |= dict.fromkeys({HIDDEN})",
        f"for name in {names}:",
        "    importlib.import_module(f'tacshade_edge.cli.commands.{name}')",
    ]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], cwd=ROOT, check=True)
