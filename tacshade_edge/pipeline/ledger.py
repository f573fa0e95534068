"""Records one outcome for every captured frame, and the durations of the stages."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Literal

FrameOutcome = Literal["published", "superseded", "without_contact", "unasked", "invalid", "failed"]

# Percentiles cover this many of the latest frames: some seconds at camera rates.
WINDOW_FRAMES = 512
# The first frames open the camera and warm up. They would stay in the window for half a minute, or
# for minutes at few frames per second.
START_S = 5.0


@dataclass(slots=True)
class Counts:
    """Frames since the start; captured is the sum of the others
    (docs/explanation/architecture.md).
    """

    captured: int = 0
    published: int = 0
    superseded: int = 0
    without_contact: int = 0
    unasked: int = 0
    invalid: int = 0
    failed: int = 0
    pending: int = 0

    def as_dict(self) -> dict[str, int]:
        return asdict(self)


class FrameLedger:
    """Records each frame's arrival and its one outcome; thread-safe.

    A second outcome is a defect: KeyError.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._open: set[int] = set()
        self._counts = Counts()
        self._closed = False

    def captured(self, seq: int) -> None:
        with self._changed:
            # After a stop, a thread that hung may still bring a frame.
            if self._closed:
                return
            if seq in self._open:
                raise KeyError(f"frame {seq} was captured twice")
            self._open.add(seq)
            self._counts.captured += 1

    def passed(self, outcome: FrameOutcome) -> None:
        """Record a frame that comes no further: it cannot be decoded, or nobody needs it."""
        with self._changed:
            if not self._closed:
                self._counts.captured += 1
                self._count(outcome)

    def settle(self, seq: int, outcome: FrameOutcome) -> None:
        with self._changed:
            if not self._closed:
                # Not `discard`: a second outcome of a frame would break the sum that `health`
                # proves.
                self._open.remove(seq)
                self._count(outcome)
                self._changed.notify_all()

    def _count(self, outcome: FrameOutcome) -> None:
        setattr(self._counts, outcome, getattr(self._counts, outcome) + 1)

    def close(self, timeout_s: float) -> int:
        """Wait for the open frames, record the rest as failed and nothing after that;
        return how many failed.
        """
        with self._changed:
            self._changed.wait_for(lambda: not self._open, timeout_s)
            given_up = len(self._open)
            self._counts.failed += given_up
            self._open.clear()
            self._closed = True
            return given_up

    def counts(self) -> Counts:
        with self._changed:
            return Counts(**{**asdict(self._counts), "pending": len(self._open)})


class Timings:
    """Latest durations by name, in ms, without those of the start once it is over; thread-safe."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._lock = threading.Lock()
        self._ms: dict[str, deque[float]] = {}
        self._clock_s = clock_s
        self._start_ends_s: float | None = None
        self._of_start: set[str] = set()

    def add(self, ms: Mapping[str, float]) -> None:
        with self._lock:
            now_s = self._clock_s()
            if self._start_ends_s is None:
                self._start_ends_s = now_s + START_S
            for name, value in ms.items():
                values = self._ms.setdefault(name, deque(maxlen=WINDOW_FRAMES))
                if now_s <= self._start_ends_s:
                    self._of_start.add(name)
                elif name in self._of_start:
                    # Only now that there is another, so that a name never lacks its value.
                    self._of_start.remove(name)
                    values.clear()
                values.append(value)

    def percentiles(self) -> dict[str, dict[str, float]]:
        """``{name: {"p50": ms, "p99": ms}}`` by nearest rank over the latest frames."""
        with self._lock:
            # Not by NumPy: its percentile imports numpy.ma, a megabyte in every process.
            ordered = {name: sorted(values) for name, values in self._ms.items()}
        return {
            name: {f"p{p}": round(values[-(-p * len(values) // 100) - 1], 3) for p in (50, 99)}
            for name, values in ordered.items()
        }


class StageTimer:
    """Times the stages of one frame after another, in one thread."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}  # of the current frame
        self.last_ns = 0  # end of its latest stage, CLOCK_MONOTONIC
        self.ended = 0  # number of stages, of all frames

    def begin(self) -> None:
        self.ms = {}
        self.last_ns = time.monotonic_ns()

    def mark(self, stage: str) -> None:
        now_ns = time.monotonic_ns()
        self.ms[stage] = (now_ns - self.last_ns) / 1e6
        self.last_ns = now_ns
        self.ended += 1
