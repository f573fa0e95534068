"""Commands whose output or log goes to a full disk, to a closed pipe or nowhere."""

from __future__ import annotations

import fcntl
import os
import re
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from support.painted_sensor import painted_calibration
from support.patience import patience, wait_until
from tacshade_edge.calibration.files import calibration_file

QUICK = {
    "version": "--version",
    "help": "--help",
    "help of a command": "replay --help",
    "a long list": "simulate --help",
    "completion": "completion bash",
    "settings": "check-config s.yaml",
    "schema": "check-config --schema",
    "pictures": "doctor a.png --calibration c.npz --profile fast",
    "doctor": "doctor --config none.yaml",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("streams")
    calibration = painted_calibration()
    calibration_file.save(folder / "c.npz", calibration)
    (folder / "s.yaml").write_text("calibration: c.npz\nsource: {kind: simulated}\n")
    import cv2
    import numpy as np

    shape = calibration.image_height_px, calibration.image_width_px
    cv2.imwrite(str(folder / "a.png"), np.zeros(shape, np.uint8))
    return folder


def run(folder: Path, words: str, redirect: str) -> subprocess.CompletedProcess[str]:
    line = f"{sys.executable} -m tacshade_edge {words} {redirect}"
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize("words", QUICK.values(), ids=QUICK)
def test_no_stream_gives_a_traceback(folder: Path, words: str) -> None:
    usual = run(folder, words, "")
    full = run(folder, words, "> /dev/full")
    assert full.returncode == 1
    assert "Traceback" not in full.stderr
    (said,) = [line for line in full.stderr.splitlines() if "standard output" in line]
    assert said == "tacshade-edge: standard output: No space left on device"
    assert "Exception ignored" not in full.stderr
    piped = run(folder, words, "| true; exit ${PIPESTATUS[0]}")
    assert piped.returncode in (usual.returncode, 1)
    assert "Traceback" not in piped.stderr
    assert "Exception ignored" not in piped.stderr
    for redirect in (">&-", "2> /dev/full", "2>&-", "<&- >&- 2>&-"):
        closed = run(folder, words, redirect)
        assert closed.returncode == usual.returncode, redirect
        assert "Traceback" not in closed.stderr
        if ">&-" not in redirect or redirect == "2>&-":
            assert timeless(closed.stdout) == timeless(usual.stdout)


def timeless(printed: str) -> str:
    """What a command printed without the time of the day, which `doctor` names."""
    return re.sub(r"\d\d:\d\d UTC", "", printed)


def test_a_full_disk_is_named(folder: Path) -> None:
    full = run(folder, "--version", "> /dev/full")
    assert (full.returncode, full.stderr) == (
        1,
        "tacshade-edge: standard output: No space left on device\n",
    )


PRINTS = """
import os, sys
from tacshade_edge.cli.streams import flush_stdout, prepare_streams
prepare_streams()
for _ in range(3000):
    print("x" * 99, file={"1": sys.stdout, "2": sys.stderr}[sys.argv[1]])
flush_stdout()
"""
PRINTED = 3000 * 100
"""Bytes: several times what a pipe holds."""
PIPE_FULL = 50_000


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2])
def test_a_stream_that_would_not_block_loses_nothing_and_costs_nothing(number: int) -> None:
    """As Node.js and ssh leave a pipe or a terminal that they share."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETFL, fcntl.fcntl(writing, fcntl.F_GETFL) | os.O_NONBLOCK)
    command = ["bash", "-c", f'exec "$0" -c "$1" {number} {number}>&{writing}']
    with (
        open(reading, "rb") as stream,
        subprocess.Popen([*command, sys.executable, PRINTS], pass_fds=[writing]) as child,
    ):
        os.close(writing)
        stat = Path(f"/proc/{child.pid}/stat")
        try:
            wait_until(
                lambda: is_full(reading) and stat.read_text().rpartition(") ")[2][0] == "S",
                20,
                "it sleeps until somebody reads",
            )
            assert len(stream.read()) == PRINTED
            assert child.wait(patience(20)) == 0
        finally:
            child.kill()


def is_full(pipe: int) -> bool:
    held = int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, b"\0" * 4), sys.byteorder)
    return held > PIPE_FULL
