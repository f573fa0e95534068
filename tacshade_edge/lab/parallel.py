"""Executors for independent jobs, here or on a cluster; results in the order of their tasks."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any, Protocol, TypeVar

import cv2

from tacshade_edge.errors import DeviceError

Task = TypeVar("Task")
Result = TypeVar("Result")
SPAWN = multiprocessing.get_context("spawn")
"""How processes start here: fork would copy the locks of OpenCV's threads."""
Report = Callable[[str, int, int], None]
"""A progress callback: receives the name of the counted items, the number done, and the total."""


def usable_cores() -> int:
    """Cores that this process may use (``taskset`` limits them)."""
    return len(os.sched_getaffinity(0))


class Workers(Protocol):
    """An executor of ``concurrent.futures``; only its ``map`` is used."""

    def map(self, fn: Callable[[Task], Result], tasks: Iterable[Task], /) -> Iterator[Result]:
        """Yield ``fn(task)`` of every task, in their order."""


class ThisProcess:
    """Runs each job in this process when its result is requested."""

    def map(self, fn: Callable[[Task], Result], tasks: Iterable[Task], /) -> Iterator[Result]:
        """Yield ``fn(task)`` of every task."""
        return map(fn, tasks)


@contextlib.contextmanager
def workers(cluster: str | None = None) -> Iterator[Workers]:
    """Start a process for each usable core, or connect to a Dask cluster, if its address is given.

    With one core, jobs run in this process. Jobs are module-level functions. Raises DeviceError (a
    process was killed; the cluster or its workers are lost) and ConfigError (no Dask is installed
    here; the cluster runs another program).
    """
    if cluster is not None:
        from tacshade_edge.lab.cluster import connected

        with connected(cluster) as remote:
            yield remote
    elif usable_cores() == 1:
        yield ThisProcess()
    else:
        with processes() as found:
            yield found


@contextlib.contextmanager
def processes(
    *,
    fresh: bool = False,
    most: int | None = None,
    prepare: Callable[..., None] | None = None,
    arguments: Sequence[Any] = (),
) -> Iterator[ProcessPoolExecutor]:
    """Start a process for each usable core, at most `most`, or, if `fresh`, for each job; each
    calls ``prepare(*arguments)`` first.

    Raises DeviceError (a process was killed).
    """
    pool = ProcessPoolExecutor(
        most or usable_cores(),
        mp_context=SPAWN,
        initializer=_start,
        initargs=(prepare, *arguments),
        # Memory that one task has taken would count for the next.
        max_tasks_per_child=1 if fresh else None,
    )
    before, complete = multiprocessing.active_children(), False
    try:
        yield pool
        complete = True
    except BrokenProcessPool:
        raise DeviceError(
            "the system killed a worker process, perhaps because memory ran out"
        ) from None
    finally:
        # Nobody needs the unfinished jobs.
        if not complete:
            for worker in multiprocessing.active_children():
                if worker not in before:
                    worker.terminate()
        # Wait: the pool's semaphores would outlive a process that ends before its pool does.
        pool.shutdown(wait=True, cancel_futures=True)


def reported_map(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: Workers,
    report: Report,
    what: str,
) -> Iterator[Result]:
    """Yield the results of ``workers.map`` and report progress."""
    report(what, 0, len(tasks))
    for k, result in enumerate(workers.map(function, tasks), 1):
        report(what, k, len(tasks))
        yield result


def _start(prepare: Callable[..., None] | None, *arguments: Any) -> None:
    """Limit a worker to one thread, end it with the command, however that ends, and prepare it."""
    # Each core has a worker already: more threads would only wait for each other.
    cv2.setNumThreads(1)
    # Ctrl-C reaches every process of the terminal: each would print a traceback of its own.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        wait([parent.sentinel])
        os._exit(1)

    # A parent that is killed cannot stop its workers; its pipe closes in any case.
    threading.Thread(target=follow, name="follow-parent", daemon=True).start()
    if prepare is not None:
        prepare(*arguments)
