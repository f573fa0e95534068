"""How wrong outputs are, by profile, image size and networks, on presses whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, score_cloud
from tacshade_edge.lab.studies.evaluate.work import (
    DEPTHS_MM,
    Case,
    PressedSensor,
    Scene,
    null_cases,
    scenes,
)
from tacshade_edge.sensor.depth.sigma import INTERVAL_90
from tacshade_edge.sensor.image.preprocess import halved_calibration
from tacshade_edge.sensor.image.white import halved
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F64, U8, Bool, Calibration, Frame, Need, Reconstruction
from tacshade_edge.wire import binary, messages

NULL_FRAMES = 10
DRAG_MM = 1.5
"""How far each object is dragged, on a skin of 20 mm; in the direction of its rotation."""


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
    # Eq. 13.
    found["cloud"] = (
        # A contact that was missed counts as undeformed skin: it would otherwise improve the mean.
        score_cloud(points, truth.points_mm, 1.0).me_mm if len(points) else truth.depth_max_mm
    )
    touched = truth.contact_on(height)
    true_mm, true_shear_mm = (
        truth.sampled(each, height) for each in (truth.height_mm, truth.shear_mm)
    )
    if touched is None or true_mm is None:
        return found
    # Where something touches, or is said to: phantoms count as much as what is missed.
    off_mm = np.abs(height.height_mm - true_mm)
    cells = (touched | height.contact) & np.isfinite(off_mm)
    found["height"] = float(off_mm[cells].mean()) if cells.any() else truth.depth_max_mm
    if result.shear_mm is not None and true_shear_mm is not None:
        off = np.linalg.norm(result.shear_mm - true_shear_mm, axis=-1)
        cells = touched & np.isfinite(off)
        found["shear"] = float(off[cells].mean()) if cells.any() else math.nan
    if result.sigma_mm is not None and height.contact.any():
        inside = off_mm <= INTERVAL_90 * result.sigma_mm
        # Too wide is as wrong as too narrow.
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
        return outputs_of(self.profile, calibration.touch)


def outputs_of(profile: str, touch: Collection[str]) -> tuple[str, ...]:
    """The outputs that a profile can have, if those in `touch` have a touch model."""
    missing = set() if profile in touch else {"touch"}
    if PROFILES[profile].network is None:
        missing |= {"shear", "sigma"}
    return tuple(name for name in OUTPUTS if name not in missing)


def settings(profiles: Sequence[str], calibration: Calibration) -> tuple[Setting, ...]:
    """All settings of these profiles; fitted ones where the calibration has a fitted network
    of the profile.
    """
    # Only even sizes halve without a rest.
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
            # The truth has the image of the camera that would be used.
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
    # Another place for each object, so that no place decides.
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
