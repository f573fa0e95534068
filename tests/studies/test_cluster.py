"""A Dask scheduler and workers on loopback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.studies import parallel
from tacshade_edge.studies.evaluate.sensors import SensorName
from tacshade_edge.studies.evaluate.work import Evaluation, Plan, evaluate
from tacshade_edge.studies.parallel import Workers, processes, workers
from tools.testbed.patience import patience

needs_dask = pytest.mark.skipif(find_spec("distributed") is None, reason="Dask is not installed (the extra cluster)")
ROOT = Path(__file__).parents[2]
PLAN = Plan((SensorName("tacshade", 5),), ("fast",), ("ball", "ring"), 1, 8, depths_mm=(2.0,), null_frames=2)


@contextmanager
def dask(kind: str, *words: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A program of Dask's in the checkout, which listens on loopback only."""
    command = [sys.executable, "-m", "distributed.cli.dask_" + kind, *words, "--host", "127.0.0.1", "--no-dashboard"]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "DASK_TEMPORARY_DIRECTORY": str(folder)}
    environment["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "1"  # not 3: there are four workers to kill
    with (folder / f"{kind}.log").open("ab") as log:
        made = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log)
    try:
        yield made
    finally:
        made.kill()
        made.wait()


@contextmanager
def scheduler(folder: Path) -> Iterator[str]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with dask("scheduler", "--port", str(port), folder=folder):
        yield f"tcp://127.0.0.1:{port}"


@contextmanager
def four_workers(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    with ExitStack() as stack:
        address = stack.enter_context(scheduler(folder))
        words = ("--no-nanny", "--nthreads", "1")
        yield address, [stack.enter_context(dask("worker", address, *words, folder=folder)) for _ in range(4)]


def evaluated(pool: Workers, victim: subprocess.Popen[bytes] | None = None) -> Evaluation:
    def report(what: str, done: int, total: int) -> None:
        if victim is not None and (what, done) == ("objects pressed", 1):
            assert victim.poll() is None
            victim.kill()

    return evaluate(PLAN, pool, report)


def where(task: int) -> tuple[int, int]:
    time.sleep(0.05)  # so that no worker takes all tasks
    return task, os.getpid()


def refuse(task: int) -> int:
    raise ConfigError(f"sensor {task}: no")


def die(task: int) -> int:
    os._exit(task)


@pytest.mark.slow
@needs_dask
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Dask's, of closed sockets
def test_a_cluster_that_loses_a_worker_gives_the_same_bits_as_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parallel, "CONNECT_S", patience(30))
    with processes() as pool:
        expected = evaluated(pool)
    with four_workers(tmp_path) as (address, started):
        with workers(address) as pool:
            assert len({pid for _, pid in pool.map(where, range(40))}) >= 2
            found = evaluated(pool, started[0])
        assert repr(found.rows) == repr(expected.rows)  # repr: NaN is not NaN, and floats are exact
        assert [c.calibration.crc32 for c in found.calibrations] == [c.calibration.crc32 for c in expected.calibrations]
        assert started[0].wait(timeout=patience(10)) < 0
        with workers(address) as pool:
            assert [task for task, _ in pool.map(where, range(100))] == list(range(100))
        with pytest.raises(ConfigError, match="sensor 1: no"), workers(address) as pool:
            list(pool.map(refuse, [1]))
        with monkeypatch.context() as patch:
            patch.setattr(parallel, "checksum", lambda package: 0)
            with pytest.raises(ConfigError, match="another tacshade_edge in"), workers(address) as pool:
                list(pool.map(where, [1]))
        with monkeypatch.context() as patch:
            patch.setattr("distributed.versions._version_cached", lambda package: "0.1")
            with pytest.raises(ConfigError, match=r"scheduler has dask .*, expected 0\.1"), workers(address):
                pass
        with pytest.raises(DeviceError, match="one job killed 2 workers"), workers(address) as pool:
            list(pool.map(die, [1]))
        with monkeypatch.context() as patch:
            patch.setattr(parallel, "CONNECT_S", 2.0)
            with pytest.raises(DeviceError, match="found no worker"), workers(address) as pool:
                list(pool.map(die, [1]))  # the last one


@needs_dask
@pytest.mark.slow
def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "CONNECT_S", 0.5)
    with pytest.raises(DeviceError, match=r"cluster tcp://127\.0\.0\.1:1: no Dask scheduler answered"):
        workers("tcp://127.0.0.1:1").__enter__()
    with pytest.raises(ConfigError, match=r"found 'carrier pigeon://x', expected tcp://HOST:8786"):
        workers("carrier pigeon://x").__enter__()


def test_without_the_extra_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(ConfigError, match=r"found no Dask, which a cluster needs; to install it: pip install"):
        workers("tcp://127.0.0.1:8786").__enter__()
