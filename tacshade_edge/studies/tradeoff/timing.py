"""What a frame takes: one setting at a time, in rounds, so that a busy moment of the machine meets them all."""

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
"""Of a round, for each setting; at least one frame, at most all of them."""
IDLE_FRAMES = 5
"""Frames without contact in each setting's part of a round."""
FRAME_NS = 1_000_000_000 // 60
"""From frame to frame by their time stamps: what is not asked at every frame costs as in a stream."""


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """Milliseconds of processor time that frames took.

    Attributes
    ----------
    contact : tuple of float64 (n, 1 + number of stages)
        Of each round the frames in contact: the step without shear, then `STAGES`, NaN where one is not run. n
        is 0 where the setting finds no contact.
    idle : tuple of float64 (m,)
        Of each round the frames without contact.
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
    """Time them all, on one thread of this process.

    Parameters
    ----------
    contact : sequence of sequences of uint8 (H, W) or (H, W, 3)
        For each setting the images in which it finds a contact.
    idle : sequence of the same
        Images without contact.

    Returns
    -------
    (list of Times, float)
        Of each setting; and how many times longer all of it took than this thread worked: 1 where nothing else ran.
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
    """A setting's reconstructor, where it is in its frames, and what they took."""

    def __init__(self, made: Reconstructor, contact: Sequence[U8], idle: Sequence[U8]) -> None:
        self.made, self.contact, self.idle = made, contact, idle
        self.taken: list[F64] = []
        self.waiting: list[F64] = []
        self._count = self._next = self._next_idle = self._t_ns = 0

    def begin(self) -> None:
        """Find how many frames fit into a slice; the first step imports and allocates, the second is timed."""
        if self.contact:
            usual_ms = [float(self._step(self.contact[0])[0]) for _ in range(2)][1]
            self._count = min(len(self.contact), max(1, int(SLICE_MS / usual_ms)))

    def round(self) -> None:
        """Time the next frames."""
        if self._count > 1:
            self._step(self.contact[self._next])  # what ran before has left nothing of ours in the caches
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
        without = sum(ms for name, ms in stages.items() if name not in ("shear", "sigma"))  # nobody has asked for it
        return np.array([without, *(stages.get(name, np.nan) for name in STAGES)])
