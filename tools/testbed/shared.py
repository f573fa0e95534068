"""What is dear to make is made by one of pytest's workers, and read by the others."""

from __future__ import annotations

import fcntl
import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Made = TypeVar("Made")
folder: Path | None = None
"""One of this run, which all its workers have; conftest.py sets it. Without one everything is made here."""


def once_for_all_workers(name: str, make: Callable[[], Made]) -> Made:
    """What `make` returns; `name` is of it alone. Its arrays are read-only, as those of a worker that made it."""
    if folder is None:
        return make()
    path = folder / f"{hashlib.sha256(name.encode()).hexdigest()}.pickle"
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # given back when the file is closed, also by a worker that dies
        if not path.exists():
            buffers: list[pickle.PickleBuffer] = []
            data = pickle.dumps(make(), protocol=5, buffer_callback=buffers.append)
            part = path.with_suffix(".part")
            part.write_bytes(pickle.dumps((data, [bytes(buffer.raw()) for buffer in buffers])))
            part.rename(path)
    data, kept = pickle.loads(path.read_bytes())
    made: Made = pickle.loads(data, buffers=kept)
    return made
