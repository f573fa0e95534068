"""Simulate a twin: frames of sensors like the user's own, as the networks receive them."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tacshade_edge.calibration.reference.references import with_reference
from tacshade_edge.errors import DecodeError
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.npz import read_arrays
from tacshade_edge.lab.fitting.patches import renderer_of
from tacshade_edge.lab.fitting.prints import BLURS_PX, Found
from tacshade_edge.lab.fitting.skins import (
    NUISANCE_PART,
    Unevenness,
    disturbed,
    random_presses,
    random_skin,
    true_maps,
    true_shear,
    wide_presses,
)
from tacshade_edge.lab.simulator.drag import TURNING
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import undeformed
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.image.white import CellMeans
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, F64, U8, Bool, Calibration


@dataclass(frozen=True, slots=True)
class Mechanics:
    """Ranges of a skin's decay length and friction."""

    decay_mm: tuple[float, float] = (1.3, 3.8)
    friction: tuple[float, float] = (0.6, 1.0)


WHOLE, HALVED = "accurate", "balanced"
"""A profile of each way to preprocess a picture."""
REFERENCES = 3
WIDE_PART = 0.1
"""Share of the presses that are of plates and of large objects."""
# Lengths and radii in pitches that a print can have: a cloud reaches beyond.
LOWEST, HIGHEST = np.array((0.2, 0.08, 0.08, 0.2)), np.array((2.5, 0.48, 0.48, 0.62))
DRAG_DECAY_MM, COULOMB = (2.0, 12.0), (0.8, 10.0)
"""Ranges of the mechanics that no press shows."""
TWO_SCALES_PART, UNEVEN_PART = 0.3, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames of several sensors with the same skins; lengths are in disc radii.

    `reference` (dict of str to uint8 (S, N, N)): white of each sensor at rest, for `WHOLE` and
    `HALVED`. `white`: dict of str to uint8 (F, N, N). `height`: float16 (F, N, N). `contact`: bool
    (F, N, N). `shear`: float16 (F, N / 2, N / 2, 2). `sensor` (int64 (F,)): each frame's row in
    `reference`.
    """

    reference: dict[str, U8]
    white: dict[str, U8]
    height: np.typing.NDArray[np.float16]
    contact: Bool
    shear: np.typing.NDArray[np.float16]
    sensor: np.typing.NDArray[np.int64]


class View:
    """A sensor of the cloud, which draws frames and preprocesses them
    as its own calibration would.
    """

    def __init__(
        self, calibration: Calibration, found: Found, values: F64, rng: np.random.Generator
    ) -> None:
        model, layout = found.at(values)
        disc = calibration.geometry.disc
        self.model = replace(
            model,
            # As far as calibrations of the same sensor differ from each other.
            row_c=disc.row_c + float(rng.normal(0, 0.3)),
            col_c=disc.col_c + float(rng.normal(0, 0.3)),
            disc_radius_px=disc.radius_px * (1 + float(rng.normal(0, 0.003))),
            blur_px=model.blur_px * float(rng.uniform(0.85, 1.2)),
            read_noise_grey=float(rng.uniform(0.8, 3.0)),
            shot_noise_grey=float(rng.uniform(1.0, 4.0)),
            specular_spots=int(rng.integers(0, 5)),
            position_tolerance_mm=float(rng.uniform(0.01, 0.05)),
            size_tolerance=float(rng.uniform(0.01, 0.05)),
            print_seed=int(rng.integers(1 << 30)),
        )
        self.renderer = renderer_of(found, self.model, layout)
        clean = self.renderer.draw(undeformed(self.model.skin_radius_mm))
        greys = [self.renderer.level(clean, int(rng.integers(1 << 30))) for _ in range(REFERENCES)]
        # Each view has its own reference, as each sensor has: the networks see a frame against it.
        own = with_reference(calibration, greys)
        made = {way: Preprocessor(own, PROFILES[way]) for way in (WHOLE, HALVED)}
        self._ways = {
            way: (
                each,
                CellMeans(each.integrator, disc_map.map_grid(each.calibration.geometry.disc)),
            )
            for way, each in made.items()
        }
        self.reference = {
            way: _bytes(cells.means(each.reference_white) / np.float32(255))
            for way, (each, cells) in self._ways.items()
        }

    def wear(self, dome: SensorModel) -> None:
        """Show skins with the mechanics of another sensor's."""
        self.model = self.renderer.model = on_dome(self.model, dome)

    def white(self, image: U8) -> dict[str, U8]:
        """White of the cells of a picture, for `WHOLE` and `HALVED`."""
        return {
            way: _bytes(cells.means(each.preprocess(each.grey(image)).white))
            for way, (each, cells) in self._ways.items()
        }


def on_dome(model: SensorModel, dome: SensorModel) -> SensorModel:
    """Give a sensor the mechanics of another sensor's skin."""
    return replace(
        model,
        **{
            name: getattr(dome, name)
            for name in (
                "skin_radius_mm",
                "skin_decay_mm",
                "friction",
                "drag_decay_mm",
                "coulomb",
                "sway",
                "bulge",
                "pin_lag",
            )
        },
    )


def _bytes(white: F32) -> U8:
    return np.rint(255 * white).astype(np.uint8)


def drawn_values(found: Found, rng: np.random.Generator) -> F64:
    """A member of the cloud of prints that look like the reference."""
    # What the reference does not decide differs from view to view: networks learn not to rely on
    # it.
    values = rng.multivariate_normal(found.values, found.cloud())
    values[:4] = np.clip(values[:4], LOWEST, HIGHEST)
    values[-1] = np.clip(values[-1], *BLURS_PX)
    return values


def drawn_dome(
    base: SensorModel, mechanics: Mechanics, rng: np.random.Generator
) -> tuple[SensorModel, Unevenness]:
    """Draw the mechanics of a skin."""

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    dome = replace(
        base,
        # Evenly over ratios: twice as long is as far as half as long.
        skin_decay_mm=math.exp(draw(*np.log(mechanics.decay_mm))),
        friction=draw(*mechanics.friction),
        drag_decay_mm=draw(*DRAG_DECAY_MM),
        coulomb=math.exp(draw(*np.log(COULOMB))),
        sway=draw(0.0, 0.6),
        bulge=draw(0.0, 0.9) if rng.random() < 0.25 else 0.0,
        pin_lag=draw(0.0, 0.4),
    )
    kind = rng.random()
    if kind < TWO_SCALES_PART:
        return dome, Unevenness(two_scales=True, mechanics=TURNING if rng.random() < 0.7 else None)
    if kind < TWO_SCALES_PART + UNEVEN_PART:
        side = len(undeformed(base.skin_radius_mm).height_mm)
        # Seven values across the dome: gel that was cast unevenly varies slowly.
        coarse = rng.normal(0, 0.3, (7, 7)).astype(np.float32)
        stiffness = np.exp(cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)).astype(
            np.float32
        )
        skirt = (draw(0, 0.4) if rng.random() < 0.5 else 0.0, draw(1, 6))
        return dome, Unevenness(stiffness, draw(-0.3, 1.5) if rng.random() < 0.5 else 0.0, skirt)
    return dome, Unevenness()


def drawn_presses(model: SensorModel, rng: np.random.Generator) -> tuple[Press, ...]:
    """Draw objects."""
    return wide_presses(model, rng) if rng.random() < WIDE_PART else random_presses(model, rng)


def simulate(
    calibration: Calibration,
    prints: Sequence[Found],
    mechanics: Mechanics,
    seed: int,
    skins: int,
    views: int,
) -> Frames:
    """Simulate skins, each with its own mechanics, that several prints of the cloud show."""
    rng = np.random.default_rng((seed, 31))
    seen = []
    for _ in range(views):
        found = prints[int(rng.integers(len(prints)))]
        seen.append(View(calibration, found, drawn_values(found, rng), rng))
    disc = calibration.geometry.disc
    white: dict[str, list[U8]] = {way: [] for way in (WHOLE, HALVED)}
    heights, contacts, shears = [], [], []
    for _ in range(skins):
        dome, unevenness = drawn_dome(prints[0].base, mechanics, rng)
        skin, presses = random_skin(dome, unevenness, rng, drawn_presses)
        # A skin is solved once and shown by every print.
        for view in seen:
            view.wear(dome)
            image = view.renderer.level(view.renderer.draw(skin), int(rng.integers(1 << 30)))
            if rng.random() < NUISANCE_PART:
                image = disturbed(image, disc, rng)
            height, contact = true_maps(skin, presses, view.model.geometry, disc)
            for way, cells in view.white(image).items():
                white[way].append(cells)
            heights.append(height.astype(np.float16))
            contacts.append(contact)
            shears.append(true_shear(skin, view.model, disc).astype(np.float16))
    return Frames(
        {way: np.stack([view.reference[way] for view in seen]) for way in white},
        {way: np.stack(each) for way, each in white.items()},
        np.stack(heights),
        np.stack(contacts),
        np.stack(shears),
        np.tile(np.arange(views), skins),
    )


# Of one array: a damaged file must not ask for all memory.
BYTES_MAX = 1 << 28


class Steps:
    """The steps of one fit.

    Files of other fits are removed, what else lies in the folder stays. `folder`: made if it is not
    there. `digest`: of everything that the steps depend on. Raises DeviceError (the folder cannot
    be written).
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder, self._own = folder, f"fit-{digest[:16]}-"
        with disk_errors(folder.parent):
            folder.mkdir(exist_ok=True)
            # Those of a fit that was given up would fill a card.
            for path in folder.glob("fit-*.npz"):
                if not path.name.startswith(self._own):
                    path.unlink()

    def has(self, name: str) -> bool:
        """Whether a step is finished."""
        return self._path(name).exists()

    def save_frames(self, name: str, frames: Frames) -> None:
        """Keep a batch's frames. Raises DeviceError."""
        plain = {field.name: getattr(frames, field.name) for field in fields(Frames)}
        ways = {
            f"{what}.{way}": each
            for what in ("reference", "white")
            for way, each in plain.pop(what).items()
        }
        self._save(name, plain | ways)

    def frames(self, name: str) -> Frames:
        """A batch's frames. Raises DecodeError for a damaged file, which is removed."""
        made: dict[str, Any] = {"reference": {}, "white": {}}
        for key, each in self._load(name).items():
            what, _, way = key.partition(".")
            if way:
                made[what][way] = each
            else:
                made[what] = each
        return Frames(**made)

    def save_weights(self, name: str, weights: F32) -> None:
        """Keep a network's weights. Raises DeviceError."""
        self._save(name, {"weights": weights})

    def weights(self, name: str) -> F32:
        """A network's weights. Raises DecodeError for a damaged file, which is removed."""
        weights: F32 = self._load(name)["weights"]
        return weights

    def remove(self) -> None:
        """Remove the files, and the folder if nothing else lies there."""
        for path in self._folder.glob(f"{self._own}*.npz"):
            path.unlink()
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def _path(self, name: str) -> Path:
        return self._folder / f"{self._own}{name}.npz"

    def _save(self, name: str, arrays: dict[str, Any]) -> None:
        file = io.BytesIO()
        np.savez(file, **arrays)
        with disk_errors(self._folder):
            # Not synced: after a power cut, a step is computed again.
            write_whole(self._path(name), file.getvalue(), sync=False)

    def _load(self, name: str) -> dict[str, Any]:
        path = self._path(name)
        try:
            # PyTorch wants to own it.
            return {key: each.copy() for key, each in read_arrays(path, BYTES_MAX).items()}
        # Removed, so that the next try computes it anew.
        except DecodeError:
            path.unlink()
            raise
