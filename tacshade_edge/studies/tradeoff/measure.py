"""The settings of the study, and what each costs on this machine: scores of the same images, time, memory."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.core.depth import Depth
from tacshade_edge.core.depth.hybrid_sfs import HybridSfs, finite_shape_grey, hybrid_depth, scaled
from tacshade_edge.core.image.preprocess import GreyMaps
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.core.reconstruct import STAGES, Reconstructor
from tacshade_edge.inference.network import load_network
from tacshade_edge.studies.evaluate.score import Row, score
from tacshade_edge.studies.evaluate.work import (
    DEPTHS_MM,
    PRESSES,
    REFERENCES,
    RINGS,
    Case,
    SensorName,
    calibrate_sensors,
    null_cases,
    one_thread,
    press_cases,
    scenes,
    stages_ms,
    work_ns,
)
from tacshade_edge.studies.parallel import Report, Workers, processes, reported_map
from tacshade_edge.types import F64, U8, Bool, Calibration, Frame


def scaled_grey(maps: GreyMaps, alpha_mm: float) -> Depth:
    """The depth α g_hn, in place of `hybrid_sfs.hybrid_depth`: the starting point of the iterations of eq. 11."""
    g_hn, bad = finite_shape_grey(maps)
    return scaled(g_hn.astype(np.float64), alpha_mm, bad)


WORDS: dict[str, Callable[[Any], str]] = {
    "solver": "solver {}".format,
    "halved": lambda halved: "halved" if halved else "not halved",
    "stride_px": "stride {} px".format,
    "window_pitches": "window {} pitch".format,
    "tv_weight": "TV {:g}".format,
}
"""The varied fields, and a formatter of each."""

# A frame takes half a second at stride 1; only the decisive variations use it.
_AROUND_PAPER: tuple[dict[str, Any], ...] = (
    {"scaled_grey": True},
    {"halved": True},
    {"stride_px": 4},
    {"stride_px": 8},
    {"stride_px": 4, "window_pitches": 1},
    {"stride_px": 4, "tv_weight": 0.0},
    {"stride_px": 4, "scaled_grey": True},
)


@dataclass(frozen=True, slots=True)
class Setting:
    """A way to reconstruct."""

    profile: Profile  # a shipped one, or a variation with its name, network and factor
    scaled_grey: bool = False  # the paper's method without eq. 11

    @property
    def shipped(self) -> bool:
        """Whether a user can choose the setting by name."""
        return self == Setting(PROFILES[self.profile.name])

    @property
    def fields(self) -> dict[str, Any]:
        """The fields that may vary (`WORDS`), with their values."""
        solver = {"solver": "grey"} if self.scaled_grey else {}
        return {field: getattr(self.profile, field) for field in WORDS} | solver

    @property
    def varied(self) -> str:
        """The differences from the shipped profile; empty for that profile itself."""
        base = Setting(PROFILES[self.profile.name]).fields
        words = [WORDS[field](value) for field, value in self.fields.items() if value != base[field]]
        return ", ".join(words)

    def __str__(self) -> str:
        """The setting's name for people, unique in a grid."""
        return ", ".join(filter(None, (self.profile.name, self.varied)))


def grid(names: Sequence[str]) -> tuple[Setting, ...]:
    """The shipped profiles of these names, each followed by its variations."""
    settings = []
    for profile in (PROFILES[name] for name in names):
        around = ({"halved": not profile.halved},) if profile.network else _AROUND_PAPER
        settings.append(Setting(profile))
        settings += [_changed(profile, changes) for changes in around]
    return tuple(settings)


def _changed(profile: Profile, changes: Mapping[str, Any]) -> Setting:
    own = {field: value for field, value in changes.items() if field in Setting.__dataclass_fields__}
    return Setting(replace(profile, **{field: changes[field] for field in changes.keys() - own.keys()}), **own)


def make(setting: Setting, calibration: Calibration) -> Reconstructor:
    """Make the reconstructor of a setting, with its own network if it needs one."""
    profile = setting.profile
    if profile.network:
        return Reconstructor(calibration, profile, load_network(profile.network))
    return Reconstructor(
        calibration,
        profile,
        make_solver=partial(HybridSfs, depth=scaled_grey if setting.scaled_grey else hybrid_depth),
    )


NULL_FRAMES = 10
"""Number of frames without contact of each simulated sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorCases:
    """All images of one sensor."""

    calibration: Calibration
    cases: tuple[Case, ...]


def simulated(
    sensors: Sequence[SensorName], objects: Sequence[str], workers: Workers, report: Report
) -> tuple[SensorCases, ...]:
    """Render every object at one place of each sensor (the next object at the next place) and three depths.

    Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed).
    """
    calibrations = calibrate_sensors(sensors, REFERENCES, PRESSES, workers, report)
    tasks = [(name, what, k) for name in sensors for k, what in enumerate((*objects, None))]
    found = list(reported_map(_cases, tasks, workers, report, "objects pressed"))
    count = len(objects) + 1
    return tuple(
        SensorCases(made.calibration, tuple(case for some in found[k * count : (k + 1) * count] for case in some))
        for k, made in enumerate(calibrations)
    )


def _cases(task: tuple[SensorName, str | None, int]) -> list[Case]:
    """Presses of one object, or frames without contact, on one sensor."""
    name, object_name, number = task
    sensor = name.make()
    if object_name is None:
        return list(null_cases(name, sensor, NULL_FRAMES))
    first = number % len(RINGS) * len(DEPTHS_MM)
    return list(press_cases(name, sensor, scenes(sensor.model, name.seed, object_name)[first : first + len(DEPTHS_MM)]))


def score_settings(
    settings: Sequence[Setting], sensors: Sequence[SensorCases], workers: Workers, report: Report
) -> list[list[list[Row]]]:
    """Rows for each setting, sensor and image, nested in that order. Raises DeviceError (a worker was killed)."""
    tasks = [(setting, each) for setting in settings for each in sensors]
    rows = list(reported_map(_rows, tasks, workers, report, "settings scored"))
    count = len(sensors)
    return [rows[k * count : (k + 1) * count] for k in range(len(settings))]


def _rows(task: tuple[Setting, SensorCases]) -> list[Row]:
    setting, sensor = task
    made = make(setting, sensor.calibration)
    return [score(case.label, case.truth, made.step(Frame(0, 0, 0, case.image))) for case in sensor.cases]


def peak_memory(
    settings: Sequence[Setting], calibration: Calibration, images: Sequence[U8], report: Report
) -> list[float]:
    """Peak resident memory in MiB that each setting adds to its own process while it reconstructs the images.

    Python, NumPy, OpenCV, ONNX Runtime and the images do not count; the reconstructor's tables and network, and the
    temporary memory of a step, do. Raises DeviceError (a worker was killed).
    """
    tasks = [(setting, calibration, images) for setting in settings]
    with processes(fresh=True) as workers:
        return list(reported_map(_peak_mib, tasks, workers, report, "settings weighed"))


def _peak_mib(task: tuple[Setting, Calibration, Sequence[U8]]) -> float:
    setting, calibration, images = task
    with contextlib.suppress(OSError):  # if a kernel cannot reset the peak, that of the imports is hardly higher
        Path("/proc/self/clear_refs").write_text("5")
    before = _greatest_kib()
    made = make(setting, calibration)
    for image in images:
        made.step(Frame(0, 0, 0, image))
    return (_greatest_kib() - before) / 1024


def _greatest_kib() -> int:
    found = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1])


ROUNDS = 15
SLICE_MS = 100.0
"""Time for each setting in a round, in ms; at least one frame, at most all of them."""
IDLE_FRAMES = 5
"""Number of frames without contact in each setting's part of a round."""
FRAME_NS = 1_000_000_000 // 60
"""Interval of the frames' time stamps in ns, so that work not done on every frame costs as much as in a stream."""


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """Processor time of frames in ms, an array for each round; a setting that finds no contact has none in contact."""

    # (n, 1 + number of stages): the step without shear and sigma, then `STAGES`, NaN if not run
    contact: tuple[F64, ...]
    idle: tuple[F64, ...]  # (m,) frames without contact


def time_settings(
    settings: Sequence[Setting],
    calibration: Calibration,
    contact: Sequence[Sequence[U8]],
    idle: Sequence[U8],
    report: Report,
    rounds: int = ROUNDS,
) -> tuple[list[Times], float]:
    """Time all settings in rounds on one thread of this process, so that a busy moment affects all settings.

    For each setting, `contact` has the images in which it finds a contact. Also returns elapsed time over this thread's
    processor time, 1 if nothing else ran.
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
    """The figures of a setting; a missed contact counts as undeformed skin (`evaluate.report.Figures`)."""

    setting: Setting
    presses: int
    missed: int
    untouched: int  # frames without contact
    phantoms: int  # those in which a contact was found
    me_mm: Estimate  # a mean over presses, with its interval from resampled presses, as the next three
    sd_pct: Estimate
    iou: Estimate
    depth_off_pct: Estimate
    p50_ms: Estimate  # processor time in contact: the median over rounds of a round's median, from resampled rounds
    p99_ms: Estimate
    fps: float  # frames in contact that one thread processes per second
    timed: int
    idle_p50_ms: float  # frames without contact
    stages_ms: tuple[tuple[str, float, float], ...]  # stage, p50, p99
    peak_mib: float  # memory that the setting adds to the bare process
    front: bool  # no other setting is clearly better in ME or p50 and not clearly worse in the other


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
    """Summarise each setting's rows (on the same images in the same order), times (in the same rounds) and memory."""
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


WEIGHED_IMAGES = 3


def weigh_and_time(
    settings: Sequence[Setting], sensors: Sequence[SensorCases], rows: Sequence[Sequence[Sequence[Row]]], report: Report
) -> tuple[tuple[Point, ...], float]:
    """Add memory and time on the first sensor's images, on this machine, to each setting's scores (`score_settings`).

    Also returns how busy the machine was (`time_settings`). Raises DeviceError (a worker was killed).
    """
    first = sensors[0]
    images = [case.image for case in first.cases if case.touched][:WEIGHED_IMAGES]
    peaks = peak_memory(settings, first.calibration, images, report)
    contact = [
        [case.image for case, row in zip(first.cases, some[0], strict=True) if row.contact and case.touched]
        for some in rows
    ]
    idle = [case.image for case in first.cases if not case.touched]
    times, busy = time_settings(settings, first.calibration, contact, idle, report)
    found = points(settings, [[row for of_sensor in some for row in of_sensor] for some in rows], times, peaks)
    return found, busy
