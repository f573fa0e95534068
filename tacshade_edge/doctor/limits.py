"""Parallel jobs with a time limit each: a job that hangs is abandoned, one that fails is reported."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TypeVar

T = TypeVar("T")


def start(job: Callable[[], T]) -> Future[T]:
    """Run a job in a thread that does not keep the process alive."""
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(job())
        except Exception as error:  # noqa: BLE001 (a defect of one check must not hide what the others found)
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return future


def wait_for(future: Future[T], deadline_s: float, failed: Callable[[str], T]) -> T:
    """Return the job's result, or ``failed(why)`` if it raised or did not end by `deadline_s` (``time.monotonic``)."""
    try:
        error = future.exception(max(0.0, deadline_s - time.monotonic()))
    except FutureTimeoutError:
        return failed("no answer in time")
    return future.result() if error is None else failed(f"the check itself failed: {type(error).__name__}: {error}")
