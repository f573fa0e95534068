"""The workers of a Dask cluster, through Dask's own executor;
results in the order of their tasks.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import platform
import sys
import threading
import warnings
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from functools import cache
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import cv2

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.version import how_to_install

Task = TypeVar("Task")
Result = TypeVar("Result")

WAIT_S = 10.0
"""Longest wait in s for a scheduler's answer, and for a worker while there is none."""
AHEAD = 4
"""Submitted jobs per thread: the scheduler holds them in memory, and some contain images."""
DECISIVE = (
    "dask",
    "distributed",
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "onnxruntime",
)
"""Packages whose versions must be this machine's, so that the results are."""
# A worker may have several threads, but networks serve one at a time.
_one_job = threading.Lock()


class ClusterWorkers:
    """An executor on a connected cluster; a job whose worker is lost runs again on another."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        # Not pure: Dask would take tasks with equal arguments for one, though a task may read the
        # clock.
        self._executor = client.get_executor(pure=False)

    def map(self, fn: Callable[[Task], Result], tasks: Iterable[Task], /) -> Iterator[Result]:
        """Yield ``fn(task)`` of every task, in their order.

        Raises ConfigError (the scheduler or a worker runs another program) and DeviceError (the
        scheduler or every worker is lost, or one job killed several workers).
        """
        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        left, ours, jobs = iter(tasks), program(), deque[Any]()
        try:
            most = AHEAD * max(1, sum(self._client.nthreads().values()))
            while True:
                for task in islice(left, most - len(jobs)):
                    # Our versions go with every job: a worker may join, or be upgraded, between two
                    # of them.
                    jobs.append(self._executor.submit(run, ours, fn, task))
                if not jobs:
                    return
                yield self._result(jobs.popleft())
        except KilledWorker as error:
            found = f"one job killed {error.allowed_failures + 1} workers"
            raise DeviceError(f"cluster {self._address}: {found}") from None
        except (CancelledError, CommClosedError):
            found = "lost the connection to the scheduler"
            raise DeviceError(f"cluster {self._address}: {found}") from None
        except RuntimeError as error:
            if "deserialization" not in str(error):
                raise
            found = "the scheduler cannot import this program, expected the same one as here"
            raise ConfigError(f"cluster {self._address}: {found}") from None
        finally:
            for job in jobs:
                job.cancel()

    def _result(self, job: Any) -> Any:
        """Wait for a result while there is a worker. Raises DeviceError if none comes in time."""
        while True:
            try:
                return job.result(timeout=WAIT_S)
            except TimeoutError:
                # A time-out of the job itself looks like ours.
                if job.done():  # the job raised it
                    raise
                _await_worker(self._client, self._address)


@contextlib.contextmanager
def connected(address: str) -> Iterator[ClusterWorkers]:
    """Connect to a scheduler, such as ``tcp://scheduler:8786``, while the context lasts.

    Raises ConfigError (the extra is not installed, or the address is not valid) and DeviceError
    (no scheduler answers, or it has no worker).
    """
    try:
        import dask
        from distributed import Client
        from distributed.versions import VersionMismatchWarning
    except ImportError:
        found = "found no Dask, which a cluster needs"
        raise ConfigError(
            f"--cluster: {found}; to install it: {how_to_install('cluster')}"
        ) from None
    # It repeats our one line on many.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    # A task with images is large on purpose, and the warning would come for each.
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `run` reports it in one line
            # Not the default client: other code of this process must not find it by chance.
            client = Client(address, timeout=WAIT_S, set_as_default=False)
    except ValueError as error:
        raise ConfigError(
            f"--cluster: found {address!r}, expected tcp://HOST:8786 ({error})"
        ) from None
    except OSError:
        found = f"no Dask scheduler answered within {WAIT_S:g} s"
        raise DeviceError(f"cluster {address}: {found}") from None
    with client:
        _await_worker(client, address)
        yield ClusterWorkers(client, address)


def _await_worker(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=WAIT_S)
    except TimeoutError:
        raise DeviceError(f"cluster {address}: found no worker, expected at least one") from None


def run(expected: Mapping[str, str], fn: Callable[[Task], Result], task: Task) -> Result:
    """Run a job on a worker. Raises ConfigError if the worker's program is not the caller's."""
    for name, version in expected.items():
        found = version_of(name)
        if found != version:
            where = f"cluster worker {platform.node()}, {sys.executable}"
            raise ConfigError(
                f"{where}: found {name} {found}, expected {version}, as on the machine that asks"
            )
    with _one_job:
        cv2.setNumThreads(1)
        return fn(task)


def program() -> dict[str, str]:
    """What this process runs: the versions of Python, the decisive packages and our sources."""
    ours = [name for name in ("tacshade_edge", "tools") if name in sys.modules]
    return {name: version_of(name) for name in ("Python", *DECISIVE, *ours)}


@cache
def version_of(name: str) -> str:
    """A package's version; of our own ones, a CRC-32 of the Python sources and networks."""
    if name == "Python":
        return platform.python_version()
    if name in DECISIVE:
        return metadata.version(name)
    # By content: a checkout has one version for every state of its sources.
    folder, crc32 = Path(str(importlib.import_module(name).__file__)).parent, 0
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".onnx", ".json"):
            entry = str(path.relative_to(folder)).encode()
            crc32 = zlib.crc32(path.read_bytes(), zlib.crc32(entry, crc32))
    return f"{crc32:08x}"
