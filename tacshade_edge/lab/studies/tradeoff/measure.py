"""What outputs cost on this machine and how wrong they are, by profile, image size and networks."""

from __future__ import annotations

import functools
import math
import operator
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.doctor.tail import TAILED
from tacshade_edge.lab.parallel import Report
from tacshade_edge.lab.studies.evaluate.work import one_thread
from tacshade_edge.lab.studies.tradeoff.judging import OUTPUTS, JudgedFrames, Setting
from tacshade_edge.lab.studies.tradeoff.timing import Timed, weigh
from tacshade_edge.types import F64, Calibration, Need

WEIGHED_IMAGES = 3
ROUNDS = 12
DRAWS = 1000
LEAST = 3
"""Fewest scenes for which an interval is drawn."""
HELD = 0.8
"""Part of the processor that frames may take; the rest is for cameras, broker and system."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean over scenes and its 95 % bootstrap interval; NaN if unknown."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Times:
    """Processor time of a frame in contact, NaN if none was found,
    and the median of frames without contact.
    """

    p50_ms: float
    p99_ms: float
    mean_ms: float
    idle_ms: float


@dataclass(frozen=True, slots=True)
class Promise:
    """How old messages were when a subscriber of the daemon itself had decoded them, how many of
    the frames after the first second were lost, and the p99 of plain work that takes `control_ms`,
    at the same rate.
    """

    p50_ms: float
    p99_ms: float
    frames: int
    lost: int
    through: str  # the broker, for people
    control_ms: float
    control_p99_ms: float

    @property
    def is_disturbed(self) -> bool:
        """Whether the machine let plain work wait too, so that no settings are to blame."""
        return self.control_p99_ms > TAILED * self.control_ms


@dataclass(frozen=True, slots=True)
class Offer:
    """What some outputs together cost with a setting, and how wrong each of them is."""

    outputs: tuple[str, ...]
    setting: Setting
    width_px: int  # of an image
    height_px: int
    errors: Mapping[str, Estimate]  # a missed contact counts as undeformed skin
    scenes: int
    missed: int
    untouched: int  # frames without contact
    phantoms: int  # those in which a contact was found
    times: Times
    peak_mib: float
    front: bool = False  # none with the same outputs is both faster and more accurate
    promise: Promise | None = None  # only of settings that the daemon was tried with

    @property
    def image(self) -> str:
        """The image's size, for people."""
        return f"{self.width_px}x{self.height_px}"

    def fps(self, fingers: int, cores: int) -> float:
        """Frames in contact per second that each finger can have, at most a core each,
        in `HELD` of the processor.
        """
        # A finger cannot use two cores: its frames follow each other.
        return HELD * 1000 / self.times.mean_ms * min(1.0, cores / fingers)


def relative_errors(rows: Sequence[Offer]) -> F64:
    """The errors of rows of the same outputs in units of the least of them, averaged over outputs;
    NaN if unknown.
    """
    errors = np.array([[each.value for each in row.errors.values()] for row in rows])
    known = errors[:, np.isfinite(errors).any(axis=0)] if len(rows) else errors
    if not known.size:
        return np.full(len(rows), np.nan)
    relative: F64 = (known / np.maximum(np.nanmin(known, axis=0), 1e-9)).mean(axis=1)
    return relative


def measure(
    settings: Sequence[Setting],
    asked: Sequence[tuple[str, ...]],
    calibration: Calibration,
    judged: Sequence[JudgedFrames],
    report: Report,
) -> tuple[list[Offer], float]:
    """Weigh and time the settings on the first sensor's images, whose calibration it is: a row for
    each setting that has all the outputs asked for together.

    Also returns elapsed time over this thread's processor time, 1 if nothing else ran. Raises
    DeviceError (a worker was killed).
    """
    # Those of the calibration.
    first = [each for each in judged if each.sensor == judged[0].sensor]
    images = [each.image for each in first if each.touched][:WEIGHED_IMAGES]
    touched, untouched = (
        [each for each in judged if each.touched is touched] for touched in (True, False)
    )
    estimates = _estimates(np.array([each.errors for each in touched]))
    peaks = weigh(settings, calibration, images, report)
    with one_thread():
        timed = [_timed(setting, calibration, first) for setting in settings]
        busy = _rounds([one for some in timed for one in some], report)
    found = _Measured(calibration, touched, untouched, estimates, timed, peaks)
    rows = [row for outputs in asked for row in _offers(settings, outputs, found)]
    return rows, busy


@dataclass(frozen=True, slots=True)
class _Measured:
    """What is known of the settings, by their places."""

    calibration: Calibration
    touched: Sequence[JudgedFrames]
    untouched: Sequence[JudgedFrames]
    estimates: Sequence[Sequence[Estimate]]  # (settings, outputs)
    timed: Sequence[Sequence[Timed]]
    peaks_mib: Sequence[float]


def _timed(
    setting: Setting, calibration: Calibration, first: Sequence[JudgedFrames]
) -> list[Timed]:
    """A setting's frames with depth, σ and shear, and where it can, with touch too."""
    needs = [Need.SIGMA | Need.SHEAR]
    if "touch" in setting.outputs(calibration):
        needs.append(Need.ALL)
    return [Timed(setting, need, calibration, first) for need in needs]


def _rounds(timed: Sequence[Timed], report: Report) -> float:
    """Time all in rounds; return elapsed time over this thread's processor time."""
    rng, start, worked = np.random.default_rng(0), time.perf_counter(), time.thread_time()
    # In rounds, each in another order, so that a busy moment or a warm board affects all settings.
    for done in range(ROUNDS):
        report("rounds of timing", done, ROUNDS)
        for k in rng.permutation(len(timed)):
            timed[k].round()
    busy = (time.perf_counter() - start) / (time.thread_time() - worked)
    report("rounds of timing", ROUNDS, ROUNDS)
    return busy


def _offers(settings: Sequence[Setting], outputs: tuple[str, ...], found: _Measured) -> list[Offer]:
    """The rows of some outputs together."""
    calibration = found.calibration
    rows = [
        Offer(
            outputs,
            setting,
            calibration.image_width_px >> setting.half,
            calibration.image_height_px >> setting.half,
            {name: found.estimates[k][list(OUTPUTS).index(name)] for name in outputs},
            scenes=len(found.touched),
            missed=sum(not each.contact[k] for each in found.touched),
            untouched=len(found.untouched),
            phantoms=sum(bool(each.contact[k]) for each in found.untouched),
            times=_times(found.timed[k], outputs),
            peak_mib=found.peaks_mib[k],
        )
        for k, setting in enumerate(settings)
        if {*outputs} <= {*setting.outputs(calibration)}
    ]
    places = list(zip(relative_errors(rows), (row.times.p50_ms for row in rows), strict=True))
    return [
        replace(row, front=_in_front(place, places))
        for row, place in zip(rows, places, strict=True)
    ]


def _in_front(place: tuple[float, float], places: Sequence[tuple[float, float]]) -> bool:
    """Whether no other is both more accurate and as fast."""
    error, p50_ms = place
    beaten = any(less < error and ms <= p50_ms for less, ms in places)
    return math.isfinite(error + p50_ms) and not beaten


def _estimates(errors: F64) -> list[list[Estimate]]:
    """Means over scenes of errors (scenes, settings, outputs);
    every setting and output sees the same draws.
    """
    count = len(errors)
    # The same draws for all: differences between settings are then those of settings.
    drawn = np.random.default_rng(0).integers(max(count, 1), size=(DRAWS, count))
    values = _mean(errors[None])[0]
    draws = _mean(errors[drawn]) if count >= LEAST else np.full((1, *values.shape), np.nan)
    # Whole scenes are drawn anew (Efron 1979): errors of the cells of a scene go together.
    ends = np.percentile(draws, (2.5, 97.5), axis=0)
    return [
        [Estimate(*map(float, each)) for each in zip(*some, strict=True)]
        for some in zip(values, *ends, strict=True)
    ]


def _mean(errors: F64) -> F64:
    """Means over the second axis of what is known."""
    # An output of which nothing is known has NaN, not a warning.
    with np.errstate(invalid="ignore"):
        means: F64 = np.nansum(errors, axis=1) / np.isfinite(errors).sum(axis=1)
    return means


def _times(timed: Sequence[Timed], outputs: Sequence[str]) -> Times:
    """The times with these outputs only."""
    need = functools.reduce(operator.or_, (OUTPUTS[name].need for name in outputs))
    # Without touch, a daemon does not compute it: the first has the times.
    one = timed[-1 if Need.TOUCH in need else 0]
    unasked = {
        part for part, flag in (("shear", Need.SHEAR), ("sigma", Need.SIGMA)) if flag not in need
    }
    unasked |= {f"encode {name}" for name in OUTPUTS if name not in outputs}
    taken = [
        sum(ms for part, ms in frame.items() if part not in unasked) for frame in one.contact
    ] or [math.nan]
    idle = [sum(frame.values()) for frame in one.idle] or [math.nan]
    p50, p99 = np.percentile(taken, (50, 99))
    return Times(float(p50), float(p99), float(np.mean(taken)), float(np.median(idle)))
