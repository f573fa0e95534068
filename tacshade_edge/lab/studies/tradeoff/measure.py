"""What outputs cost on this machine and how wrong they are, by profile, image size and networks."""

from __future__ import annotations

import contextlib
import functools
import math
import operator
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacshade_edge.lab.parallel import Report, Workers, processes, reported_map
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, score_cloud
from tacshade_edge.lab.studies.evaluate.work import (
    DEPTHS_MM,
    Case,
    PressedSensor,
    Scene,
    null_cases,
    one_thread,
    scenes,
)
from tacshade_edge.sensor.depth.sigma import INTERVAL_90
from tacshade_edge.sensor.image.preprocess import halved_calibration
from tacshade_edge.sensor.image.white import halved
from tacshade_edge.sensor.inference.network import make_reconstructor, runtime
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F64, U8, Bool, Calibration, Frame, Need, Reconstruction
from tacshade_edge.wire import binary, messages

NULL_FRAMES = 10
DRAG_MM = 1.5
"""How far each object is dragged, on a skin of 20 mm; in the direction of its rotation."""
WEIGHED_IMAGES = 3
ROUNDS = 12
SLICE_MS = 100.0
"""Time for each setting in a round; at least one frame, at most all of them."""
IDLE_FRAMES = 5
FRAME_NS = 1_000_000_000 // 60
DRAWS = 1000
LEAST = 3
"""Fewest scenes for which an interval is drawn."""
HELD = 0.8
"""Part of the processor that frames may take; the rest is for cameras, broker and system."""


@dataclass(frozen=True, slots=True)
class Output:
    """What the daemon computes and encodes for a topic,
    and the error by which `errors` judges it.
    """

    need: Need
    encode: Callable[[Reconstruction], bytes]
    what: str
    unit: str = "mm"
    spec: str = ".3f"


def _binary(encode: Callable[..., bytes]) -> Callable[[Reconstruction], bytes]:
    return lambda result: encode(result, calibration_crc32=0)


OUTPUTS: dict[str, Output] = {
    "contact": Output(
        Need.DEPTH, lambda result: messages.encode_contact(result, fps=0.0), "greatest depth"
    ),
    "height": Output(Need.DEPTH, _binary(binary.encode_height), "mean over the contact"),
    "cloud": Output(Need.DEPTH, _binary(binary.encode_cloud), "ME, eq. 13"),
    "shear": Output(Need.SHEAR, _binary(binary.encode_shear), "mean over the contact"),
    "touch": Output(Need.TOUCH, messages.encode_touch, "see calibrate --labels"),
    "sigma": Output(
        Need.SIGMA, _binary(binary.encode_sigma), "share in 90 % intervals, from 90 %", "%", ".0f"
    ),
}


def errors(result: Reconstruction, truth: KnownTruth) -> dict[str, float]:
    """How wrong each output is, as far as that is known;
    a missed contact counts as undeformed skin.
    """
    height, points = result.height, result.cloud.points_mm
    found = {"contact": abs(result.depth_max_mm - truth.depth_max_mm)}
    found["cloud"] = (
        score_cloud(points, truth.points_mm, 1.0).me_mm if len(points) else truth.depth_max_mm
    )
    touched = truth.contact_on(height)
    true_mm, true_shear_mm = (
        truth.sampled(each, height) for each in (truth.height_mm, truth.shear_mm)
    )
    if touched is None or true_mm is None:
        return found
    off_mm = np.abs(height.height_mm - true_mm)
    cells = (touched | height.contact) & np.isfinite(off_mm)
    found["height"] = float(off_mm[cells].mean()) if cells.any() else truth.depth_max_mm
    if result.shear_mm is not None and true_shear_mm is not None:
        off = np.linalg.norm(result.shear_mm - true_shear_mm, axis=-1)
        cells = touched & np.isfinite(off)
        found["shear"] = float(off[cells].mean()) if cells.any() else math.nan
    if result.sigma_mm is not None and height.contact.any():
        inside = off_mm <= INTERVAL_90 * result.sigma_mm
        found["sigma"] = abs(100 * float(inside[height.contact].mean()) - 90)
    return found


@dataclass(frozen=True, slots=True)
class Setting:
    """A profile at the calibration's image size or half of it,
    with the calibration's fitted networks or without.
    """

    profile: str
    half: bool
    fitted: bool

    def image(self, image: U8) -> U8:
        """The image that its camera would take."""
        return halved(image) if self.half else image

    def make(self, whole: Calibration) -> Reconstructor:
        """Make its reconstructor."""
        calibration = halved_calibration(whole) if self.half else whole
        return make_reconstructor(
            calibration if self.fitted else replace(calibration, fitted={}), PROFILES[self.profile]
        )

    def outputs(self, calibration: Calibration) -> tuple[str, ...]:
        """The outputs that it can have."""
        missing = set() if self.profile in calibration.touch else {"touch"}
        if PROFILES[self.profile].network is None:
            missing |= {"shear", "sigma"}
        return tuple(name for name in OUTPUTS if name not in missing)


def settings(profiles: Sequence[str], calibration: Calibration) -> tuple[Setting, ...]:
    """All settings of these profiles; fitted ones where the calibration has a fitted network
    of the profile.
    """
    even = calibration.image_height_px % 2 == calibration.image_width_px % 2 == 0
    return tuple(
        Setting(profile, half, fitted)
        for profile in profiles
        for half in ((False, True) if even else (False,))
        for fitted in ((True, False) if profile in calibration.fitted else (False,))
    )


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFrames:
    """An image, and each setting's result of it."""

    sensor: str
    image: U8
    touched: bool
    contact: Bool  # (settings,) whether it was found
    errors: F64  # (settings, outputs), NaN if nothing touches


def judge(
    settings: Sequence[Setting], calibration: Calibration, cases: Iterable[Case]
) -> list[JudgedFrames]:
    """Reconstruct every case with every setting."""
    made = [(each, each.make(calibration)) for each in settings]
    judged = []
    for case in cases:
        contact = np.zeros(len(made), bool)
        off = np.full((len(made), len(OUTPUTS)), np.nan)
        for k, (setting, one) in enumerate(made):
            result = one.step(Frame(0, 0, 0, setting.image(case.image)))
            contact[k] = result.contact
            truth = case.truth.halved() if setting.half else case.truth
            if case.touched:
                found = errors(result, truth)
                off[k] = [found.get(name, math.nan) for name in OUTPUTS]
        judged.append(JudgedFrames(case.label.sensor, case.image, case.touched, contact, off))
    return judged


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A sensor to simulate, its name and seed, and its calibration."""

    name: str
    seed: int | None
    make: Callable[[], PressedSensor]
    calibration: Calibration


def simulated(
    settings: Sequence[Setting],
    sensors: Sequence[Simulation],
    objects: Sequence[str],
    workers: Workers,
    report: Report,
) -> list[JudgedFrames]:
    """Press and drag every object at one place and three depths of each sensor,
    and judge the settings.

    Raises DeviceError (a worker was killed).
    """
    tasks = [
        (tuple(settings), each, name, k)
        for each in sensors
        for k, name in enumerate((*objects, None))
    ]
    return [
        each
        for some in reported_map(_simulated, tasks, workers, report, "objects pressed")
        for each in some
    ]


def _simulated(task: tuple[Sequence[Setting], Simulation, str | None, int]) -> list[JudgedFrames]:
    settings, one, object_name, number = task
    sensor = one.make()
    if object_name is None:
        return judge(settings, one.calibration, null_cases(one.name, sensor, NULL_FRAMES))
    every = scenes(sensor.model, one.seed, object_name)
    first = number * len(DEPTHS_MM) % len(every)
    return judge(
        settings, one.calibration, _dragged(one.name, sensor, every[first : first + len(DEPTHS_MM)])
    )


def _dragged(name: str, sensor: PressedSensor, scenes: Iterable[Scene]) -> Iterator[Case]:
    """Yield a picture of each scene whose object is dragged too."""
    for scene in scenes:
        press, along = scene.press, math.radians(scene.press.rotation_deg)
        x_mm, y_mm = (DRAG_MM * press.scale * part for part in (math.cos(along), math.sin(along)))
        frame = sensor.frame((replace(press, drag_x_mm=x_mm, drag_y_mm=y_mm),), scene.noise_seed)
        truth = frame.truth()
        shear_mm = np.full((*truth.contact.shape, 2), np.nan, np.float32)
        rows, cols = np.nonzero(truth.contact)
        shear_mm[rows, cols] = frame.shear_mm(rows.astype(float), cols.astype(float))
        known = replace(KnownTruth.of(truth), height_mm=truth.height_mm, shear_mm=shear_mm)
        yield Case(Label(name, scene.object_name), known, frame.image)


def weigh(
    settings: Sequence[Setting], calibration: Calibration, images: Sequence[U8], report: Report
) -> list[float]:
    """Peak memory in MiB that each setting, with every output, adds to a process of its own.

    Python, NumPy, OpenCV, ONNX Runtime and the images do not count; the reconstructor's tables and
    networks, and the temporary memory of a step, do. Raises DeviceError (a worker was killed).
    """
    tasks = [(setting, calibration, images) for setting in settings]
    with processes(fresh=True) as workers:
        return list(reported_map(_peak_mib, tasks, workers, report, "settings weighed"))


def _peak_mib(task: tuple[Setting, Calibration, Sequence[U8]]) -> float:
    setting, calibration, images = task
    runtime()  # its import does not count
    with contextlib.suppress(
        OSError
    ):  # if a kernel cannot reset the peak, that of the imports is hardly higher
        Path("/proc/self/clear_refs").write_text("5")
    before = _peak_kib()
    made = setting.make(calibration)
    for image in images:
        made.step(Frame(0, 0, 0, setting.image(image)))
    return (_peak_kib() - before) / 1024


def _peak_kib() -> int:
    found = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1])


class Parts:
    """Processor time in ms of each part of a frame on this thread;
    call it with a part's name at its end.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        self._last_ns = time.thread_time_ns()

    def __call__(self, part: str) -> None:
        now_ns = time.thread_time_ns()
        self.ms[part] = (now_ns - self._last_ns) / 1e6
        self._last_ns = now_ns


class Timed:
    """A setting's frames on one thread, and the processor time of each part of them in ms."""

    def __init__(
        self, setting: Setting, need: Need, whole: Calibration, judged: Sequence[JudgedFrames]
    ) -> None:
        self.need = need
        self.contact: list[dict[str, float]] = []
        self.idle: list[dict[str, float]] = []
        self._outputs = [name for name in setting.outputs(whole) if OUTPUTS[name].need in need]
        self._made = setting.make(whole)
        self._t_ns = 0
        self._touched, self._untouched = (
            [setting.image(each.image) for each in judged if each.touched is touched]
            for touched in (True, False)
        )
        # The first frame imports and allocates.
        self._touched = [image for image in self._touched if "depth" in self.frame(image)]
        usual_ms = sum(self.frame(self._touched[0]).values()) if self._touched else math.inf
        self._count = min(len(self._touched), max(1, int(SLICE_MS / usual_ms)))

    def round(self) -> None:
        """Time the next frames."""
        for images, taken, count in (
            (self._touched, self.contact, self._count),
            (self._untouched, self.idle, IDLE_FRAMES if self._untouched else 0),
        ):
            first = len(taken)
            if count > 1:
                self.frame(images[first % len(images)])  # warms the caches
            taken += [self.frame(images[(first + k) % len(images)]) for k in range(count)]

    def frame(self, image: U8) -> dict[str, float]:
        """Time the stages of a frame's step, then the encoding of each output."""
        self._t_ns += FRAME_NS  # as in a stream, so that work not done on every frame costs as much
        parts = Parts()
        result = self._made.step(Frame(0, self._t_ns, 0, image), parts, self.need)
        for name in self._outputs if result is not None and result.contact else ():
            assert result is not None
            OUTPUTS[name].encode(result)
            parts(f"encode {name}")
        return parts.ms


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

    @property
    def image(self) -> str:
        """The image's size, for people."""
        return f"{self.width_px}x{self.height_px}"

    def fps(self, fingers: int, cores: int) -> float:
        """Frames in contact per second that each finger can have, at most a core each,
        in `HELD` of the processor.
        """
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
    touched, untouched = (
        [each for each in judged if each.touched is touched] for touched in (True, False)
    )
    first = [each for each in judged if each.sensor == judged[0].sensor]  # those of the calibration
    images = [each.image for each in first if each.touched][:WEIGHED_IMAGES]
    peaks = weigh(settings, calibration, images, report)
    estimates = _estimates(np.array([each.errors for each in touched]))
    with one_thread():
        timed = [
            [
                Timed(setting, need, calibration, first)
                for need in (Need.SIGMA | Need.SHEAR, Need.ALL)
                if need is not Need.ALL or "touch" in setting.outputs(calibration)
            ]
            for setting in settings
        ]
        flat = [one for some in timed for one in some]
        rng, start, worked = np.random.default_rng(0), time.perf_counter(), time.thread_time()
        for done in range(ROUNDS):  # so that a busy moment affects all settings
            report("rounds of timing", done, ROUNDS)
            for k in rng.permutation(len(flat)):
                flat[k].round()
        busy = (time.perf_counter() - start) / (time.thread_time() - worked)
        report("rounds of timing", ROUNDS, ROUNDS)
    rows: list[Offer] = []
    for outputs in asked:
        some = [
            Offer(
                outputs,
                setting,
                calibration.image_width_px >> setting.half,
                calibration.image_height_px >> setting.half,
                {name: estimates[k][list(OUTPUTS).index(name)] for name in outputs},
                scenes=len(touched),
                missed=sum(not each.contact[k] for each in touched),
                untouched=len(untouched),
                phantoms=sum(bool(each.contact[k]) for each in untouched),
                times=_times(timed[k], outputs),
                peak_mib=peaks[k],
            )
            for k, setting in enumerate(settings)
            if {*outputs} <= {*setting.outputs(calibration)}
        ]
        places = list(zip(relative_errors(some), (row.times.p50_ms for row in some), strict=True))
        for row, (error, p50_ms) in zip(some, places, strict=True):
            beaten = any(less < error and ms <= p50_ms for less, ms in places)
            rows.append(replace(row, front=math.isfinite(error + p50_ms) and not beaten))
    return rows, busy


def _estimates(errors: F64) -> list[list[Estimate]]:
    """Means over scenes of errors (scenes, settings, outputs);
    every setting and output sees the same draws.
    """
    count = len(errors)
    drawn = np.random.default_rng(0).integers(max(count, 1), size=(DRAWS, count))
    values = _mean(errors[None])[0]
    draws = _mean(errors[drawn]) if count >= LEAST else np.full((1, *values.shape), np.nan)
    ends = np.percentile(draws, (2.5, 97.5), axis=0)
    return [
        [Estimate(*map(float, each)) for each in zip(*some, strict=True)]
        for some in zip(values, *ends, strict=True)
    ]


def _mean(errors: F64) -> F64:
    """Means over the second axis of what is known."""
    with np.errstate(invalid="ignore"):
        means: F64 = np.nansum(errors, axis=1) / np.isfinite(errors).sum(axis=1)
    return means


def _times(timed: Sequence[Timed], outputs: Sequence[str]) -> Times:
    """The times with these outputs only."""
    need = functools.reduce(operator.or_, (OUTPUTS[name].need for name in outputs))
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
