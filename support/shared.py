"""One of pytest's workers makes what is expensive, and the others read it."""

from __future__ import annotations

import fcntl
import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Made = TypeVar("Made")
folder: Path | None = None
"""This run's folder, shared by all its workers; conftest.py sets it.

Without one, each process makes everything.
"""


def once_for_all_workers(name: str, make: Callable[[], Made]) -> Made:
    """The result of `make`, under a unique `name`.

    Its arrays are read-only, also in the worker that made it.
    """
    if folder is None:
        return make()
    path = folder / f"{hashlib.sha256(name.encode()).hexdigest()}.pickle"
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(
            lock, fcntl.LOCK_EX
        )  # released when the file is closed, also by a worker that dies
        if not path.exists():
            buffers: list[pickle.PickleBuffer] = []
            data = pickle.dumps(make(), protocol=5, buffer_callback=buffers.append)
            part = path.with_suffix(".part")
            part.write_bytes(pickle.dumps((data, [bytes(buffer.raw()) for buffer in buffers])))
            part.rename(path)
    data, kept = pickle.loads(path.read_bytes())
    made: Made = pickle.loads(data, buffers=kept)
    return made
