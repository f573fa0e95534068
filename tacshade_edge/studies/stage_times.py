"""Measure the time of a step's stages on one thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2

from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.types import Frame

work_ns = time.thread_time_ns
"""Processor time of this thread in ns: on an otherwise idle machine, the elapsed time."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV to one thread."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def stages_ms(
    made: Reconstructor, frame: Frame, clock_ns: Callable[[], int] = time.perf_counter_ns
) -> dict[str, float]:
    """Run one step; return the milliseconds of each stage that ran, in order. Their sum is the step's time.

    The clock `work_ns` counts only this thread's processor time, however busy the machine is.
    """
    taken: dict[str, float] = {}
    last = clock_ns()

    def mark(stage: str) -> None:
        nonlocal last
        now = clock_ns()
        taken[stage] = (now - last) / 1e6
        last = now

    made.step(frame, mark)
    return taken
