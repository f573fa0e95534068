"""However `calibrate --fit` ends, it says one line, leaves no process, and goes on next time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from support.patience import patience, wait_until
from support.processes import alive

pytestmark = [
    pytest.mark.slow,
    pytest.mark.fit,
    pytest.mark.skipif(
        find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"
    ),
]
# The command with little to simulate and long trainings; what it finds of the print is known.
SCRIPT = """
import signal
import sys
from dataclasses import replace
from support.calibrated_sensor import found_prints
from tacshade_edge.cli import main
from tacshade_edge.lab.fitting import fit
from tacshade_edge.lab.fitting.twin_work import Effort

if __name__ == "__main__":
    # Whoever runs the tests under nohup ignores it, and a child inherits that.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    fit.FULL = Effort(batches=2, held_out=1, skins=2, views=1, steps=100_000)
    fit.identify = lambda *_: found_prints()
    sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def fitting(alone: list[str], tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A fit whose workers train."""
    script = tmp_path / "fit.py"
    script.write_text(SCRIPT)
    tests = Path(__file__).parents[2]
    command = ["calibrate", *alone, "--fit", "--out", str(tmp_path / "cal.npz")]
    with subprocess.Popen(
        [sys.executable, str(script), *command],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": f"{tests}:{tests.parent}"},
    ) as made:
        steps = tmp_path / "cal.npz.fit"
        wait_until(
            lambda: made.poll() is not None or len(list(steps.glob("fit-*-frames-*.npz"))) == 2,
            patience(120),
            "the frames are simulated",
        )
        yield made
        made.kill()


def children(pid: int) -> list[int]:
    """Processes that descend from one."""
    found = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, path.read_text().split()):
            found += [child, *children(child)]
    return found


def workers(made: subprocess.Popen[str]) -> list[int]:
    """The processes of the pool, without the helper that owns its semaphores."""
    return [
        pid
        for pid in children(made.pid)
        if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]


def kept(tmp_path: Path) -> list[str]:
    return sorted(path.name[21:] for path in (tmp_path / "cal.npz.fit").glob("fit-*.npz"))


def test_a_killed_worker_is_one_line(fitting: subprocess.Popen[str], tmp_path: Path) -> None:
    wait_until(lambda: bool(workers(fitting)), 60, "a worker runs")
    os.kill(workers(fitting)[0], signal.SIGKILL)
    _, said = fitting.communicate(timeout=patience(60))
    assert fitting.returncode == 1
    lines = [line for line in said.splitlines() if not line.startswith("fit: ")]
    assert len(lines) == 1, said
    assert lines[0].startswith("tacshade-edge: the system killed a worker process")
    assert kept(tmp_path) == ["frames-0.npz", "frames-1.npz"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_no_process(
    fitting: subprocess.Popen[str], tmp_path: Path, number: signal.Signals
) -> None:
    wait_until(lambda: bool(workers(fitting)), 60, "a worker runs")
    everyone = children(fitting.pid)
    fitting.send_signal(number)
    fitting.communicate(timeout=patience(60))
    assert fitting.returncode == -number
    wait_until(lambda: not any(map(alive, everyone)), 30, "every process ended")
    assert kept(tmp_path) == ["frames-0.npz", "frames-1.npz"]
    assert not (tmp_path / "cal.npz.part").exists()
