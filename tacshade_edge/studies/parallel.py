"""Independent jobs over the machine's cores, in the order of their tasks."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import TypeVar

import cv2

from tacshade_edge.errors import DeviceError

Task = TypeVar("Task")
Result = TypeVar("Result")
Report = Callable[[str, int, int], None]
"""Called with what is counted, how many are done, and of how many."""


def usable_cores() -> int:
    """Cores that this process may use (``taskset`` limits them)."""
    return len(os.sched_getaffinity(0))


def ordered_map(
    function: Callable[[Task], Result], tasks: Sequence[Task], cores: int, *, fresh: bool = False
) -> Iterator[Result]:
    """Yield ``function(task)`` for every task, in order, from up to `cores` processes; with one, in this one.

    Parameters
    ----------
    function : callable
        Of a module, so that another process finds it.
    fresh : bool
        Each task in a new process, also with one core.

    Raises
    ------
    DeviceError
        A process was killed.
    """
    cores = min(cores, len(tasks))
    if cores < 2 and not fresh:
        yield from map(function, tasks)
        return
    context = multiprocessing.get_context("spawn")  # fork would copy OpenCV's threads' locks
    pool = ProcessPoolExecutor(cores, mp_context=context, initializer=_start, max_tasks_per_child=1 if fresh else None)
    before, complete = multiprocessing.active_children(), False
    try:
        yield from pool.map(function, tasks)
        complete = True
    except BrokenProcessPool:
        raise DeviceError("a worker process was ended from outside (not enough memory?)") from None
    finally:
        if not complete:  # nobody wants what they are at
            for worker in multiprocessing.active_children():
                if worker not in before:
                    worker.terminate()
        # Waits: the pool's semaphores would outlive a process that ends before its pool has.
        pool.shutdown(wait=True, cancel_futures=True)


def reported_map(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    cores: int,
    report: Report,
    what: str,
    *,
    fresh: bool = False,
) -> Iterator[Result]:
    """`ordered_map` that reports how far it is."""
    report(what, 0, len(tasks))
    for k, result in enumerate(ordered_map(function, tasks, cores, fresh=fresh)):
        report(what, k + 1, len(tasks))
        yield result


def _start() -> None:
    """One thread for each process; and none outlives the command, however that ends."""
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, name="follow-parent", daemon=True).start()
