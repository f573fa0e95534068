import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.patience import patience, wait_until
from support.processes import alive
from tacshade_edge.errors import DeviceError
from tacshade_edge.lab.parallel import processes, usable_cores, workers


def slow_first(task: int) -> tuple[int, int]:
    time.sleep(0.3 if task == 0 else 0)
    return task, os.getpid()


def die(task: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return task


@pytest.fixture
def one_core() -> Iterator[None]:
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    yield
    os.sched_setaffinity(0, cores)


@pytest.mark.usefixtures("one_core")
def test_one_core_works_in_this_process() -> None:
    with workers() as pool:
        assert list(pool.map(slow_first, [1, 2, 3])) == [(k, os.getpid()) for k in (1, 2, 3)]
        assert list(pool.map(slow_first, [])) == []


@pytest.mark.slow  # it starts interpreters, as do the next ones
def test_fresh_is_a_process_for_each_task_and_results_keep_their_order() -> None:
    with processes(fresh=True) as pool:
        found = list(pool.map(slow_first, [0, 1, 2]))
    assert [task for task, _ in found] == [0, 1, 2]
    assert len({os.getpid(), *(pid for _, pid in found)}) == 4


@pytest.mark.slow
def test_a_killed_process_is_one_line() -> None:
    with (
        pytest.raises(DeviceError, match="the system killed a worker process"),
        processes() as pool,
    ):
        list(pool.map(die, [0, 1]))


SCRIPT = """
import os, time
from tacshade_edge.lab.parallel import processes, usable_cores

def work(task):
    os.write(1, f"{os.getpid()}\\n".encode())  # at once: the other worker writes too
    time.sleep(600)

if __name__ == "__main__":
    with processes() as pool:
        list(pool.map(work, range(usable_cores())))
"""


@pytest.mark.slow
def test_no_process_outlives_the_command(tmp_path: Path) -> None:
    path = tmp_path / "work.py"
    path.write_text(SCRIPT, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, path], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as made:
        assert made.stdout is not None
        workers = [int(made.stdout.readline()) for _ in range(usable_cores())]
        made.send_signal(signal.SIGKILL)
        made.wait(timeout=patience(20))
        wait_until(lambda: not any(map(alive, workers)), timeout_s=20, what="all workers are gone")
