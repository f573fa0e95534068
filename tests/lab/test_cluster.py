"""A Dask scheduler and two workers, as processes on loopback."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.patience import patience
from tacshade_edge.cli import main
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.lab import cluster
from tacshade_edge.lab.parallel import Report, ThisProcess, Workers, workers
from tacshade_edge.lab.studies.evaluate.work import SensorName, evaluate

pytestmark = pytest.mark.filterwarnings(  # Dask's, of sockets that it closes late
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)
ROOT = Path(__file__).parents[2]
ALLOWED_FAILURES = 1
"""One job may kill so many workers; the third would be the last."""


@dataclass(frozen=True, slots=True)
class Started:
    """A cluster's address and its processes."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def dask(folder: Path, kind: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program of Dask's that imports this checkout."""
    command = (sys.executable, "-m", "dask", kind, *words, "--host", "127.0.0.1", "--no-dashboard")
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "DASK_TEMPORARY_DIRECTORY": str(folder),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(ALLOWED_FAILURES),
    }
    with (folder / f"{kind}.log").open("ab") as log:
        made = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
    try:
        yield made
    finally:
        made.kill()
        made.wait()


@contextmanager
def started(folder: Path, count: int) -> Iterator[Started]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    words = ("worker", address, "--no-nanny", "--nthreads", "1")
    with ExitStack() as stack:
        scheduler = stack.enter_context(dask(folder, "scheduler", "--port", str(port)))
        processes = [stack.enter_context(dask(folder, *words)) for _ in range(count)]
        yield Started(address, scheduler, processes)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "WAIT_S", patience(15))


def evaluated(pool: Workers, report: Report) -> object:
    rows, calibrations = evaluate(
        [SensorName.parse("5")],
        ("fast",),
        ("ball", "ring", "cube"),
        pool,
        report,
        references=2,
        presses=8,
        depths_mm=(2.0,),
        null_frames=2,
    )
    # As text: NaN is not equal to NaN, and text states floats exactly.
    return repr(rows), [made.calibration.crc32 for made in calibrations]


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
def test_results_and_progress_are_those_of_one_machine_although_a_worker_dies(
    tmp_path: Path,
) -> None:
    alone: list[tuple[str, int, int]] = []
    spread: list[tuple[str, int, int]] = []
    expected = evaluated(ThisProcess(), lambda *each: alone.append(each))
    with started(tmp_path, 2) as found, workers(found.address) as pool:
        assert len(set(pool.map(which, [2, 2]))) == 2  # both work

        def kill_one(*each: object) -> None:
            spread.append(each)  # type: ignore[arg-type]
            if each[:2] == ("objects pressed", 1):
                found.workers[0].kill()

        assert evaluated(pool, kill_one) == expected
        assert found.workers[0].wait(patience(10)) < 0
        assert found.workers[1].poll() is None
    assert spread == alone


def which(count: int) -> int:
    """The process that does the job, which ends when so many have begun."""
    import time

    from distributed import get_worker

    begun = Path(get_worker().local_directory).parent / f"begun {os.getpid()}"
    begun.touch()
    limit_s = time.monotonic() + 60
    while len(list(begun.parent.glob("begun *"))) < count and time.monotonic() < limit_s:
        time.sleep(0.01)
    return os.getpid()


def refuse(task: int) -> int:
    raise ConfigError(f"sensor {task}: no")


def late(task: int) -> int:
    raise TimeoutError(f"job {task}")


def twice(task: int) -> int:
    return 2 * task


def die(task: int) -> int:
    os._exit(task)


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
def test_what_goes_wrong_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with started(tmp_path, 3) as found:
        with workers(found.address) as pool:
            assert list(pool.map(twice, range(50))) == list(range(0, 100, 2))
        with pytest.raises(ConfigError, match="sensor 1: no"), workers(found.address) as pool:
            list(pool.map(refuse, [1]))
        with pytest.raises(TimeoutError, match="job 1"), workers(found.address) as pool:
            list(pool.map(late, [1]))
        ours = cluster.version_of
        with monkeypatch.context() as patch:
            patch.setattr(
                cluster, "version_of", lambda name: "0.1" if name == "numpy" else ours(name)
            )
            with (
                pytest.raises(ConfigError, match=r"worker .*: found numpy [\d.]+, expected 0\.1, "),
                workers(found.address) as pool,
            ):
                list(pool.map(twice, [1]))
        with (
            pytest.raises(DeviceError, match="one job killed 2 workers"),
            workers(found.address) as pool,
        ):
            list(pool.map(die, [1]))
        monkeypatch.setattr(cluster, "WAIT_S", 2.0)
        with (
            pytest.raises(DeviceError, match="found no worker, expected at least one"),
            workers(found.address) as pool,
        ):
            list(pool.map(die, [1]))  # the last one
        with (
            pytest.raises(DeviceError, match="found no worker, expected at least one"),
            workers(found.address),
        ):
            pass


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
def test_a_scheduler_that_is_lost_is_one_line(tmp_path: Path) -> None:
    def lose(found: Started) -> None:
        with workers(found.address) as pool:
            made = pool.map(twice, range(1000))
            assert next(made) == 0
            found.scheduler.kill()
            list(made)

    with (
        started(tmp_path, 1) as found,
        pytest.raises(DeviceError, match="lost the connection to the scheduler"),
    ):
        lose(found)


@pytest.mark.slow
def test_the_command_line_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "--sensors", "5", "--profile", "fast", "--objects", "ball", "--cluster"]
    monkeypatch.setattr(cluster, "WAIT_S", 0.5)
    assert main([*words, "tcp://127.0.0.1:1"]) == 1
    lost = "cluster tcp://127.0.0.1:1: no Dask scheduler answered within 0.5 s"
    assert capfd.readouterr().err.splitlines() == [f"tacshade-edge: {lost}"]
    assert main([*words, "pigeon://x"]) == 78
    (line,) = capfd.readouterr().err.splitlines()
    assert "found 'pigeon://x', expected tcp://HOST:8786" in line


def test_without_dask_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "dask", None)
    assert main(["evaluate", "--cluster", "tcp://127.0.0.1:8786"]) == 78
    (line,) = capfd.readouterr().err.splitlines()
    assert "found no Dask, which a cluster needs; to install it: pip install" in line


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "--out", "x", "--cluster", "tcp://h:1"],
        ["evaluate", "--images", "x", "--calibration", "c.npz", "--cluster", "tcp://h:1"],
        ["tradeoff", "--images", "x", "--calibration", "c.npz", "--cluster", "tcp://h:1"],
        ["tradeoff", "--report", "--cluster", "tcp://h:1"],
    ],
)
def test_what_runs_here_refuses_a_cluster(
    words: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(words)
    assert re.search(
        "error: --(cluster requires|cluster is for|report .* no --cluster)", capfd.readouterr().err
    )
