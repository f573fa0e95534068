"""Executors for independent jobs: this machine's cores, or a Dask cluster's; results in the order of their tasks."""

from __future__ import annotations

import contextlib
import functools
import importlib
import logging
import multiprocessing
import os
import signal
import sys
import threading
import warnings
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Protocol, TypeVar

import cv2

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.version import how_to_install

Task = TypeVar("Task")
Result = TypeVar("Result")
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
    """Start workers: a process for each core, or, given an address, the workers of a Dask cluster.

    Jobs are module-level functions, so that another process finds them; ``map`` yields results in the order of the
    tasks, wherever they run. Results are bit-identical on processors of the same kind.

    `cluster` is a scheduler's address, such as ``tcp://scheduler:8786``. Raises ConfigError (the extra `cluster` is not
    installed, or the cluster runs other versions) and DeviceError (a process was killed; the cluster cannot be reached,
    has no workers, or lost those that ran a job).
    """
    if cluster is not None:
        from tacshade_edge.studies.parallel import connected

        with connected(cluster) as found:
            yield found
    elif usable_cores() == 1:
        yield ThisProcess()
    else:
        with processes() as found:
            yield found


@contextlib.contextmanager
def processes(*, fresh: bool = False) -> Iterator[Workers]:
    """Start a process for each usable core, or, if `fresh`, for each job. Raises DeviceError (a process was killed)."""
    context = multiprocessing.get_context("spawn")  # fork would copy OpenCV's threads' locks
    reuse = 1 if fresh else None
    pool = ProcessPoolExecutor(usable_cores(), mp_context=context, initializer=_start, max_tasks_per_child=reuse)
    before, complete = multiprocessing.active_children(), False
    try:
        yield pool
        complete = True
    except BrokenProcessPool:
        raise DeviceError("the system killed a worker process, perhaps because memory ran out") from None
    finally:
        if not complete:  # nobody needs the unfinished jobs
            for worker in multiprocessing.active_children():
                if worker not in before:
                    worker.terminate()
        # Wait: the pool's semaphores would outlive a process that ends before its pool does.
        pool.shutdown(wait=True, cancel_futures=True)


def reported_map(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: Workers, report: Report, what: str
) -> Iterator[Result]:
    """Yield the results of ``workers.map`` and report progress."""
    report(what, 0, len(tasks))
    for k, result in enumerate(workers.map(function, tasks), 1):
        report(what, k, len(tasks))
        yield result


def _start() -> None:
    """Limit a worker to one thread, and end it with the command, however that ends."""
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, name="follow-parent", daemon=True).start()


CONNECT_S = 10.0
"""Longest wait in s for a scheduler's answer, and for its first worker."""
AHEAD = 4
"""Jobs in flight per thread: the scheduler holds all submitted jobs in memory, and some carry a sensor's images."""
DECIDES = ("dask", "distributed", "numpy", "scipy", "opencv-contrib-python-headless", "onnxruntime")
"""Packages that the cluster must have in our versions for bit-identical results."""


class Cluster:
    """The workers of a connected cluster; a job whose worker dies runs again on another."""

    def __init__(self, client: Any, address: str) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)
        self._ahead = AHEAD * sum(client.nthreads().values())
        self._address = address

    def map(self, fn: Callable[[Task], Result], tasks: Iterable[Task], /) -> Iterator[Result]:
        """Yield ``fn(task)`` of every task, in their order.

        Raises ConfigError (the scheduler or a worker runs a different program) and DeviceError (the scheduler or every
        worker is lost, or a job's workers died one after another).
        """
        from distributed import KilledWorker

        left = iter(tasks)
        program = {name: checksum(name) for name in ("tacshade_edge", "tools") if name in sys.modules}
        under_way = deque[Any]()
        try:
            while True:
                for task in islice(left, self._ahead - len(under_way)):
                    under_way.append(self._executor.submit(run, program, fn, task))
                if not under_way:
                    return
                yield self._result(under_way.popleft())
        except KilledWorker as error:
            raise DeviceError(f"cluster {self._address}: one job killed {error.allowed_failures + 1} workers") from None
        except CancelledError:
            raise DeviceError(f"cluster {self._address}: lost the connection to the scheduler") from None
        except RuntimeError as error:
            if "deserialization" not in str(error):
                raise
            raise ConfigError(
                f"cluster {self._address}: the scheduler lacks this program or the program's folder"
            ) from None
        finally:
            for job in under_way:
                job.cancel()

    def _result(self, job: Any) -> Any:
        """Wait for a result while there is a worker, or until one returns. Raises DeviceError if none does."""
        while True:
            try:
                return job.result(timeout=CONNECT_S)
            except TimeoutError:
                if job.done():
                    raise
                _await_worker(self._client, self._address)


@contextlib.contextmanager
def connected(address: str) -> Iterator[Cluster]:
    """Connect to a scheduler for as long as the context lasts.

    Raises ConfigError (the extra is not installed, the address is not valid, or the cluster runs other versions) and
    DeviceError (no scheduler answers, or it has no worker).
    """
    try:
        import dask
        from distributed import Client
        from distributed.versions import VersionMismatchWarning
    except ImportError:
        raise ConfigError(
            f"--cluster: found no Dask, which a cluster needs; to install it: {how_to_install('cluster')}"
        ) from None
    # Its log would repeat our one line on several; `AHEAD` bounds what the scheduler holds.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `_check_versions` reports it in one line
            client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except ValueError as error:
        raise ConfigError(f"--cluster: found {address!r}, expected tcp://HOST:8786 ({error})") from None
    except OSError:
        raise DeviceError(f"cluster {address}: no Dask scheduler answered within {CONNECT_S:g} s") from None
    with client:
        _await_worker(client, address)
        _check_versions(client.get_versions(packages=DECIDES), address)
        yield Cluster(client, address)


def _await_worker(client: Any, address: str) -> None:
    """Wait for a worker. Raises DeviceError if none appears in time."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError:
        raise DeviceError(f"cluster {address}: found no worker, expected at least one") from None


def _check_versions(found: Mapping[str, Any], address: str) -> None:
    """Compare the cluster's packages with ours. Raises ConfigError if they differ."""
    ours = found["client"]["packages"]
    for place, other in {"scheduler": found["scheduler"], **found["workers"]}.items():
        for name in ("python", *DECIDES):
            if (theirs := other["packages"].get(name)) != ours[name]:
                raise ConfigError(
                    f"cluster {address}: {place} has {name} {theirs}, expected {ours[name]}, as on this machine"
                )


def run(program: Mapping[str, int], fn: Callable[[Task], Result], task: Task) -> Result:
    """Run a job on a worker. Raises ConfigError if its program differs from the caller's."""
    for name, crc32 in program.items():
        if checksum(name) != crc32:
            raise ConfigError(
                f"cluster worker: found another version of {name} in {_folder(name)}, expected this machine's version"
            )
    cv2.setNumThreads(1)
    return fn(task)


@functools.cache
def checksum(package: str) -> int:
    """CRC-32 of a package's Python sources and networks."""
    crc32, folder = 0, _folder(package)
    for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".onnx", ".json")):
        crc32 = zlib.crc32(path.read_bytes(), zlib.crc32(str(path.relative_to(folder)).encode(), crc32))
    return crc32


def _folder(package: str) -> Path:
    return Path(str(importlib.import_module(package).__file__)).parent
