"""Summarise rows and times to a point for each setting: means with bootstrap intervals, and the Pareto front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.tradeoff.grid import Setting
from tacshade_edge.studies.tradeoff.timing import Times
from tacshade_edge.types import F64, Bool

DRAWS = 1000
LEAST = 3
"""Fewest presses (rounds) for which an interval is drawn."""
_LOW, _HIGH = 2.5, 97.5


@dataclass(frozen=True, slots=True)
class Estimate:
    """A figure and its 95 % bootstrap interval; NaN if unknown."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Point:
    """The figures of a setting.

    Attributes
    ----------
    setting : Setting
    presses, missed : int
        A missed contact counts as undeformed skin (`evaluate.summary.Figures`).
    untouched, phantoms : int
        Number of frames without contact, and of those in which a contact was found.
    me_mm, sd_pct, iou, depth_off_pct : Estimate
        Means over presses, with intervals from resampled presses.
    p50_ms, p99_ms : Estimate
        Processor time of frames in contact: the median over rounds of a round's median, the percentile over all, with
        intervals from resampled rounds.
    fps : float
        Frames in contact that one thread processes per second.
    timed : int
        Number of timed frames in contact.
    idle_p50_ms : float
        Median time of frames without contact.
    stages_ms : tuple of (stage, p50, p99)
        Times of the stages that ran.
    peak_mib : float
        Memory that the setting adds to the bare process.
    front : bool
        True if no other setting is clearly more accurate and not clearly slower, or clearly faster and not clearly less
        accurate.
    """

    setting: Setting
    presses: int
    missed: int
    untouched: int
    phantoms: int
    me_mm: Estimate
    sd_pct: Estimate
    iou: Estimate
    depth_off_pct: Estimate
    p50_ms: Estimate
    p99_ms: Estimate
    fps: float
    timed: int
    idle_p50_ms: float
    stages_ms: tuple[tuple[str, float, float], ...]
    peak_mib: float
    front: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """A figure of each setting, and the same from `DRAWS` resampled sets (draws, settings)."""

    value: F64
    draws: F64

    def estimate(self, k: int) -> Estimate:
        low, high = np.percentile(self.draws[:, k], (_LOW, _HIGH))
        return Estimate(float(self.value[k]), float(low), float(high))

    def clearly_less(self) -> Bool:
        """Whether each setting is less than each other on the same draws, in 97.5 % of them: (settings, settings)."""
        less: Bool = np.percentile(self.draws[:, :, None] - self.draws[:, None, :], _HIGH, axis=0) < 0
        return less


def points(
    settings: Sequence[Setting], rows: Sequence[Sequence[Row]], times: Sequence[Times], peak_mib: Sequence[float]
) -> tuple[Point, ...]:
    """Summarise the rows, times and memory of each setting.

    Parameters
    ----------
    settings : sequence of Setting
    rows : sequence of sequences of Row
        Rows of each setting, on the same images in the same order.
    times : sequence of Times
        Times of each setting, in the same rounds.
    peak_mib : sequence of float
    """
    pressed = [[r for r in some if r.true_points] for some in rows]
    untouched = [[r for r in some if not r.true_points] for some in rows]
    measures = {
        "me_mm": _by_press([[r.true_depth_mm if math.isnan(r.me_mm) else r.me_mm for r in some] for some in pressed]),
        "sd_pct": _by_press([[r.sd_pct for r in some] for some in pressed]),
        "iou": _by_press([[r.iou for r in some if not math.isnan(r.iou)] for some in pressed]),
        "depth_off_pct": _by_press([[abs(r.depth_error_pct) for r in some] for some in pressed]),
        "p50_ms": _by_round(times),
    }
    front = on_front(measures["me_mm"], measures["p50_ms"])
    made = []
    for k, setting in enumerate(settings):
        contact = np.concatenate(times[k].contact)
        idle = np.concatenate(times[k].idle)
        made.append(
            Point(
                setting=setting,
                presses=len(pressed[k]),
                missed=sum(math.isnan(r.me_mm) for r in pressed[k]),
                untouched=len(untouched[k]),
                phantoms=sum(r.contact for r in untouched[k]),
                **{name: drawn.estimate(k) for name, drawn in measures.items()},
                p99_ms=_p99(times[k]),
                fps=1000 / float(contact[:, 0].mean()) if len(contact) else math.nan,
                timed=len(contact),
                idle_p50_ms=float(np.median(idle)) if len(idle) else math.nan,
                stages_ms=_stages(contact),
                peak_mib=peak_mib[k],
                front=bool(front[k]),
            )
        )
    return tuple(made)


def on_front(error: _Drawn, time: _Drawn) -> Bool:
    """Whether no other setting is clearly better in one of the two and not clearly worse in the other, for each."""
    nearer, faster = error.clearly_less(), time.clearly_less()
    beats = (nearer & ~faster.T) | (faster & ~nearer.T)
    front: Bool = ~beats.any(axis=0) & np.isfinite(error.value) & np.isfinite(time.value)
    return front


def _by_press(values: Sequence[Sequence[float]]) -> _Drawn:
    """Means over presses; every setting sees the same draws."""
    array = np.array(values).T
    count, settings = array.shape if array.ndim == 2 else (0, len(values))
    if not count:
        return _Drawn(np.full(settings, np.nan), np.full((DRAWS, settings), np.nan))
    if count < LEAST:
        return _Drawn(array.mean(axis=0), np.full((DRAWS, settings), np.nan))
    drawn = np.random.default_rng(0).integers(count, size=(DRAWS, count))
    return _Drawn(array.mean(axis=0), array[drawn].mean(axis=1))


def _by_round(times: Sequence[Times]) -> _Drawn:
    """Medians over rounds of the rounds' medians; every setting sees the same draws."""
    rounds = len(times[0].contact)
    medians = np.array([[np.median(some[:, 0]) if len(some) else np.nan for some in each.contact] for each in times]).T
    drawn = np.random.default_rng(0).integers(rounds, size=(DRAWS, rounds))
    draws = np.median(medians[drawn], axis=1) if rounds >= LEAST else np.full((DRAWS, len(times)), np.nan)
    return _Drawn(np.median(medians, axis=0), draws)


def _p99(times: Times) -> Estimate:
    """The p99 of all frames; each draw weights a round by how often it was drawn."""
    rounds = [some[:, 0] for some in times.contact]
    pooled = np.concatenate(rounds)
    if not len(pooled):
        return Estimate(math.nan, math.nan, math.nan)
    value = float(np.percentile(pooled, 99, method="inverted_cdf"))
    if len(rounds) < LEAST:
        return Estimate(value, math.nan, math.nan)
    order = np.argsort(pooled)
    of_round = np.repeat(np.arange(len(rounds)), [len(some) for some in rounds])[order]
    drawn = np.random.default_rng(0).integers(len(rounds), size=(DRAWS, len(rounds)))
    counts = (drawn[:, :, None] == np.arange(len(rounds))).sum(axis=1)
    up_to = np.cumsum(counts[:, of_round], axis=1)
    draws = pooled[order][(up_to >= 0.99 * up_to[:, -1:]).argmax(axis=1)]
    low, high = np.percentile(draws, (_LOW, _HIGH))
    return Estimate(value, float(low), float(high))


def _stages(contact: F64) -> tuple[tuple[str, float, float], ...]:
    found = []
    for k, name in enumerate(STAGES, start=1):
        some = contact[:, k][np.isfinite(contact[:, k])]
        if len(some):
            found.append((name, float(np.median(some)), float(np.percentile(some, 99))))
    return tuple(found)
