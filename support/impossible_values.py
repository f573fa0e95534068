"""Files that we store, with one number replaced by an extreme one behind a right checksum."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from support.painted_sensor import FREE, TOUCHED, painted_calibration
from tacshade_edge.calibration.files import calibration_file, objects_file, reference_file
from tacshade_edge.calibration.files.reference_file import LearntLimits, StoredReference, limited
from tacshade_edge.daemon import reference_origin
from tacshade_edge.files import npz
from tacshade_edge.files.npz import Content
from tacshade_edge.sensor.inference.network import (
    load_network,
    make_reconstructor,
    touch_networks,
)
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.sensor.touch.learning import learn
from tacshade_edge.types import (
    F32,
    Calibration,
    Fit,
    Frame,
    KnownObject,
    ProfileFit,
    Reconstruction,
    RestLimits,
)

EXTREMES = (0, -1, 1e-300, 1e30, 1e300, math.nan, math.inf, 2**63, 10**30)
PROFILE = "fast"


@dataclass(frozen=True, slots=True)
class Kind:
    """A file, and how the program reads it; `used` steps frames with what was read."""

    name: str
    content: Content
    used: Callable[[Path], Reconstruction]


@cache
def calibration() -> Calibration:
    """Of every kind of number that a calibration may have."""
    plain, taken = painted_calibration(), list[F32]()
    made = Reconstructor(plain, PROFILES[PROFILE], load_network(PROFILE), touch=taken.append)
    made.step(Frame(0, 0, 0, TOUCHED))
    rng = np.random.default_rng(0)
    labels = rng.uniform(0.5, 3, (80, 2))
    clean = taken[0] + labels @ rng.normal(size=(2, len(taken[0])))
    features = (clean + 0.01 * rng.normal(size=clean.shape)).astype(np.float32)
    imprints = (labels @ rng.normal(size=(2, 4))).astype(np.float32)
    names = ("depth_mm", "force_z_n")
    learnt = learn(
        features, imprints, np.ones(80), names, labels, np.arange(80) % 5, touch_networks(PROFILE)
    ).model
    assert learnt is not None
    return replace(
        plain,
        factors={PROFILE: 1.1},
        fit=Fit(8, 0.1, 0.2, {PROFILE: ProfileFit(8, 0.1, 0.3)}),
        error_scales={PROFILE: 1.2},
        rest={PROFILE: RestLimits(120, 1e-4, 0.03, 0.01, 0.3)},
        touch={PROFILE: learnt},
    )


@cache
def kinds() -> dict[str, Kind]:
    """The kinds of file by the name of one, made once."""
    with TemporaryDirectory() as name:
        folder, plain = Path(name), painted_calibration()
        calibration_file.save(folder / "c.npz", calibration())
        limits = {PROFILE: LearntLimits(*[RestLimits(120, 1e-4, 0.03, 0.01, 0.3)] * 2)}
        stored = StoredReference(limited(plain, limits), 5, limits=limits)
        reference_file.save(folder / "c.reference.npz", plain, stored)
        touches = np.random.default_rng(0).normal(size=(3, 272)).astype(np.float32)
        objects_file.save(folder / "c.objects.npz", {PROFILE: (KnownObject("cup", touches),)})
        return {
            file: Kind(file, npz.read(str(folder / file), "", ""), used)
            for file, used in (
                ("c.npz", lambda path: stepped(calibration_file.load(path))),
                (
                    "c.reference.npz",
                    lambda path: stepped(reference_origin.restored(plain, path).calibration),
                ),
                (
                    "c.objects.npz",
                    lambda path: stepped(replace(plain, known=objects_file.load(path))),
                ),
            )
        }


def stepped(known: Calibration) -> Reconstruction:
    """The result of a touched frame after an untouched one."""
    # As in a daemon, where numpy warns and goes on.
    with np.errstate(all="ignore"):
        made = make_reconstructor(known, PROFILES[PROFILE])
        made.step(Frame(0, 0, 0, FREE))
        return made.step(Frame(1, 1, 1, TOUCHED))


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the numbers of JSON values are."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from places(inner, (*at, key))
    elif isinstance(value, list | tuple):
        for k, inner in enumerate(value):
            yield from places(inner, (*at, k))
    else:
        yield at


def changed(content: Content, part: str, place: tuple[Any, ...], extreme: float) -> bytes:
    """The file with one number of its values (`part` empty) or of an array replaced."""
    if not part:
        return Content(_with(content.meta, place, extreme), content.arrays).packed()
    array = content.arrays[part].copy()
    with np.errstate(over="ignore", invalid="ignore"):
        array.reshape(-1)[place[0] % array.size] = np.float64(extreme).astype(array.dtype)
    return Content(content.meta, {**content.arrays, part: array}).packed()


def _with(value: Any, place: tuple[Any, ...], extreme: float) -> Any:
    if not place:
        return extreme
    key, *rest = place
    inner = _with(value[key], tuple(rest), extreme)
    if isinstance(value, Mapping):
        return {**value, key: inner}
    return [inner if k == key else each for k, each in enumerate(value)]
