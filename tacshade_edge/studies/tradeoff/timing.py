"""Time frames, one setting at a time, in rounds, so that a busy moment of the machine affects all settings."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.reconstruct import STAGES, Reconstructor
from tacshade_edge.studies.parallel import Report
from tacshade_edge.studies.stage_times import one_thread, stages_ms, work_ns
from tacshade_edge.studies.tradeoff.grid import Setting, make
from tacshade_edge.types import F64, U8, Calibration, Frame

ROUNDS = 15
SLICE_MS = 100.0
"""Time for each setting in a round, in ms; at least one frame, at most all of them."""
IDLE_FRAMES = 5
"""Number of frames without contact in each setting's part of a round."""
FRAME_NS = 1_000_000_000 // 60
"""Interval of the frames' time stamps in ns, so that work not done on every frame costs as much as in a stream."""


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """Processor time of frames in ms.

    Attributes
    ----------
    contact : tuple of float64 (n, 1 + number of stages)
        Frames in contact of each round: the step without shear and sigma, then `STAGES`, NaN for a stage that did not
        run. n is 0 if the setting finds no contact.
    idle : tuple of float64 (m,)
        Frames without contact of each round.
    """

    contact: tuple[F64, ...]
    idle: tuple[F64, ...]


def time_settings(
    settings: Sequence[Setting],
    calibration: Calibration,
    contact: Sequence[Sequence[U8]],
    idle: Sequence[U8],
    report: Report,
    rounds: int = ROUNDS,
) -> tuple[list[Times], float]:
    """Time all settings on one thread of this process.

    Parameters
    ----------
    contact : sequence of sequences of uint8 (H, W) or (H, W, 3)
        For each setting, the images in which it finds a contact.
    idle : sequence of the same
        Images without contact.

    Returns
    -------
    (list of Times, float)
        Times of each setting; and elapsed time over this thread's processor time, 1 if nothing else ran.
    """
    timed = [_Timed(make(setting, calibration), some, idle) for setting, some in zip(settings, contact, strict=True)]
    rng = np.random.default_rng(0)
    with one_thread():
        for each in timed:
            each.begin()
        start, worked = time.perf_counter(), time.thread_time()
        for done in range(rounds):
            report("rounds of timing", done, rounds)
            for k in rng.permutation(len(timed)):
                timed[k].round()
        busy = (time.perf_counter() - start) / (time.thread_time() - worked)
        report("rounds of timing", rounds, rounds)
    return [Times(tuple(each.taken), tuple(each.waiting)) for each in timed], busy


class _Timed:
    """A setting's reconstructor, its position in its frames, and their times."""

    def __init__(self, made: Reconstructor, contact: Sequence[U8], idle: Sequence[U8]) -> None:
        self.made, self.contact, self.idle = made, contact, idle
        self.taken: list[F64] = []
        self.waiting: list[F64] = []
        self._count = self._next = self._next_idle = self._t_ns = 0

    def begin(self) -> None:
        """Find how many frames fit into a slice, from the second step: the first one imports and allocates."""
        if self.contact:
            usual_ms = [float(self._step(self.contact[0])[0]) for _ in range(2)][1]
            self._count = min(len(self.contact), max(1, int(SLICE_MS / usual_ms)))

    def round(self) -> None:
        """Time the next frames."""
        if self._count > 1:
            self._step(self.contact[self._next])  # warms the caches
        found = np.empty((self._count, 1 + len(STAGES)))
        for k in range(self._count):
            found[k] = self._step(self.contact[self._next])
            self._next = (self._next + 1) % len(self.contact)
        quiet = np.empty(IDLE_FRAMES if self.idle else 0)
        for k in range(len(quiet)):
            quiet[k] = self._step(self.idle[self._next_idle])[0]
            self._next_idle = (self._next_idle + 1) % len(self.idle)
        self.taken.append(found)
        self.waiting.append(quiet)

    def _step(self, image: U8) -> F64:
        self._t_ns += FRAME_NS
        stages = stages_ms(self.made, Frame(0, self._t_ns, 0, image), work_ns)
        without = sum(ms for name, ms in stages.items() if name not in ("shear", "sigma"))  # not requested
        return np.array([without, *(stages.get(name, np.nan) for name in STAGES)])
