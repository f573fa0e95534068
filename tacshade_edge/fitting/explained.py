"""Hold a height map against its picture: how much of the picture's change it leaves unexplained.

A twin's renderer draws the skin that a map describes. White of the cells that the map predicts, less that of the
predicted skin at rest, should be what the picture shows, less the reference. The part that is left, of the squares that
"no contact" would leave, needs no labels: it chooses prints and lengths of pins on a user's own touches, and vetoes a
network that explains them clearly worse. It does not rank networks as truth does (`tools.studies.strangers.explained`):
a picture does not show the scale of lengths, pins twice as long move twice as far, and the shear comes from a network.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.core.image import greyscale
from tacshade_edge.core.profiles import LADDER, PROFILES
from tacshade_edge.errors import ConfigError
from tacshade_edge.fitting.patches import (
    LENGTHS_PITCHES,
    own_picture,
    renderer_of,
    with_length,
)
from tacshade_edge.fitting.prints import Found, WhiteMap
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.simulator.render import project
from tacshade_edge.simulator.skin import Skin, direction_to_chart, node_directions, undeformed
from tacshade_edge.types import F32, F64, U8, Calibration, Frame, Geometry, Reconstruction

SMOOTH_CELLS = 4.0
"""Smoothing of the compared white: about a pitch, because where the edge of one tip lies says little of heights."""
LEAST_CHANGE = 0.01
"""RMS of the white's change over the disc below which a picture is no touch to judge by; noise changes 0.003."""
LIKELY = 1.02
"""A kind of print that leaves at most this many times the best one's part of the reference unexplained belongs to the
cloud. Kinds that leave more have wrong sizes: a cap on a pin looks like a shorter pin."""
JUDGES = tuple(LADDER)
"""The profiles whose maps choose a print."""
_ROUNDS = 5
_FARTHEST = 0.98
_MOVED_MM = 1e-3


def skin_of(geometry: Geometry, made: Reconstruction) -> Skin:
    """The skin that a reconstruction describes. Its shear contains the material's whole motion, so the renderer's model
    must have no `friction`.
    """
    flat = undeformed(geometry.skin_radius_mm)
    directions = node_directions(geometry.skin_radius_mm).astype(np.float64)
    grid, radius_mm = made.height, geometry.skin_radius_mm
    height_mm = np.nan_to_num(grid.height_mm)
    h = np.zeros(flat.height_mm.shape, np.float32)
    cols = rows = h
    for _ in range(_ROUNDS):  # the ray of a node depends on how deep it lies
        px = project(geometry, directions * (radius_mm - h)[..., None])
        cols = ((px[..., 0] - grid.col0) / grid.step_px).astype(np.float32)
        rows = ((px[..., 1] - grid.row0) / grid.step_px).astype(np.float32)
        h = cv2.remap(height_mm, cols, rows, cv2.INTER_LINEAR)
    skin = replace(flat, height_mm=h, leaning_mm=np.zeros_like(h))
    if made.shear_mm is None:
        return skin
    shear_mm = np.stack(
        [
            cv2.remap(np.ascontiguousarray(each), cols, rows, cv2.INTER_LINEAR)
            for each in np.moveaxis(np.nan_to_num(made.shear_mm), 2, 0)
        ],
        axis=-1,
    )
    points_mm = directions * (radius_mm - h)[..., None]
    xy = (points_mm[..., :2] - shear_mm) / radius_mm
    z = np.sqrt(1 - np.minimum((xy * xy).sum(axis=-1, keepdims=True), _FARTHEST))
    before_mm = _chart(np.concatenate((xy, z), axis=-1), radius_mm)
    moved = (h > _MOVED_MM) | (np.abs(shear_mm).sum(axis=-1) > _MOVED_MM)
    origin_mm = np.where(moved[..., None], before_mm - _chart(directions, radius_mm), 0)
    return replace(skin, origin_mm=origin_mm.astype(np.float32))


def _chart(directions: F64, radius_mm: float) -> F64:
    return np.stack(direction_to_chart(directions, radius_mm), axis=-1)


class Picture:
    """Holds maps of one sensor against its pictures, with a print that was found in its reference."""

    def __init__(self, calibration: Calibration, found: Found) -> None:
        model, layout = found.at(found.values)
        self._geometry = calibration.geometry
        self._renderer = renderer_of(found, replace(model, friction=0.0), layout)
        self._white = WhiteMap(calibration)
        self._reference = self._white.reference()
        self._at_rest = self._drawn(undeformed(model.skin_radius_mm))

    def change(self, image: U8) -> F32:
        """The change of white of a picture from the reference, smoothed, float32 (cells, cells)."""
        return _soft(self._white.of(greyscale.to_grey(image)) - self._reference)

    def left(self, change: F32, made: Reconstruction) -> F32:
        """What a reconstruction leaves of a change, float32 (cells, cells), 0 outside the disc."""
        predicted = _soft(self._drawn(skin_of(self._geometry, made)) - self._at_rest)
        return np.where(self._white.inside, change - predicted, np.float32(0))

    def unexplained(self, change: F32, made: Reconstruction) -> float:
        """The part of a change, by squares, that a reconstruction leaves; 1 without contact."""
        if not made.contact:
            return 1.0
        whole = float(np.square(change[self._white.inside]).sum())
        return float(np.square(self.left(change, made)).sum()) / max(whole, 1e-9)

    def is_touch(self, change: F32) -> bool:
        """Whether a picture changed enough to judge by."""
        return float(np.sqrt(np.square(change[self._white.inside]).mean())) >= LEAST_CHANGE

    def _drawn(self, skin: Skin) -> F32:
        return self._white.of(np.clip(self._renderer.draw(skin) + 0.5, 0, 255).astype(np.uint8))


def _soft(cells: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(cells, (0, 0), SMOOTH_CELLS), np.float32)


LEAST_TOUCHES = 8
"""Fewer pictures that changed choose by chance."""


class Touches:
    """Pictures of unlabelled touches, held against what networks make of them. Those that hardly changed are left out.
    Raises ConfigError (fewer than `LEAST_TOUCHES` are left).
    """

    def __init__(self, calibration: Calibration, found: Found, images: Sequence[U8]) -> None:
        self._picture = Picture(calibration, found)
        changes = [(image, self._picture.change(image)) for image in images]
        self._seen = [(image, c) for image, c in changes if self._picture.is_touch(c)]
        if len(self._seen) < LEAST_TOUCHES:
            found_touches = f"found {len(self._seen)} pictures with a touch among {len(images)}"
            raise ConfigError(f"touches: {found_touches}, expected at least {LEAST_TOUCHES}")

    def reconstructed(self, calibration: Calibration, profile: str) -> list[Reconstruction]:
        """Reconstruct the pictures with a profile."""
        made = make_reconstructor(calibration, PROFILES[profile])
        return [made.step(Frame(0, 0, 0, image)) for image, _ in self._seen]

    def left_by(self, calibration: Calibration, profile: str) -> float:
        """The mean part of the pictures' changes that a profile's heights leave unexplained."""
        return self.left(self.reconstructed(calibration, profile))

    def left(self, made: Sequence[Reconstruction], picture: Picture | None = None) -> float:
        """The mean part that reconstructions leave, also with another print's renderer."""
        with_print = picture or self._picture
        return float(
            np.mean(
                [
                    with_print.unexplained(change, each)
                    for (_, change), each in zip(self._seen, made, strict=True)
                ]
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The prints that explain touches best, the best first, and the part that the best one leaves."""

    prints: tuple[Found, ...]
    left: float
    touches: Touches


def chosen_prints(
    calibration: Calibration, prints: Sequence[Found], images: Sequence[U8], stated: bool = False
) -> Choice | None:
    """Choose, by touches, among the prints that the reference shows and its own patches, white tips with pins of
    several lengths; None without any. What the shipped networks make of the touches is right on average, so the length
    that explains it best is the pins' own, unless it is `stated`. Raises ConfigError (too few touches).
    """
    own = own_picture(calibration)
    tried = [*prints, *([own] if own else [])]
    if not tried:
        return None
    touches = Touches(calibration, tried[0], images)
    made = {name: touches.reconstructed(calibration, name) for name in JUDGES}
    tried = _with_lengths(tried, stated)

    def left(found: Found) -> float:
        picture = Picture(calibration, found)
        return float(np.mean([touches.left(each, picture) for each in made.values()]))

    lefts = [left(found) for found in tried]
    best = int(np.argmin(lefts))
    found = tried[best]
    alike = [
        each
        for each in prints
        if each.kind != found.kind and each.residual <= LIKELY * found.residual
    ]
    return Choice(
        (found, *(alike if not found.kind.patches else ())),
        lefts[best],
        Touches(calibration, found, images),
    )


def _with_lengths(prints: Sequence[Found], stated: bool = False) -> list[Found]:
    """The prints, those of white tips with each of `LENGTHS_PITCHES` unless their pins' length is stated."""
    made = []
    for found in prints:
        known = stated and not found.kind.patches
        free = found.kind.white_tips and not known
        made += [with_length(found, length) for length in LENGTHS_PITCHES] if free else [found]
    return made


def shares_left(
    calibration: Calibration, prints: Sequence[Found], profile: str, images: Sequence[U8]
) -> list[float | None]:
    """The share of each picture's change that a profile's heights leave unexplained, by the print that explains all
    pictures best; None for a picture that hardly changed, and for all without a print.
    """
    own = own_picture(calibration)
    reconstructor = make_reconstructor(calibration, PROFILES[profile])
    made = [reconstructor.step(Frame(0, 0, 0, image)) for image in images]

    def left_by(found: Found) -> list[float | None]:
        picture = Picture(calibration, found)
        changes = [picture.change(image) for image in images]
        return [
            picture.unexplained(change, each) if picture.is_touch(change) else None
            for change, each in zip(changes, made, strict=True)
        ]

    tried = [left_by(found) for found in _with_lengths([*prints, *([own] if own else [])])]
    nothing: list[float | None] = [None] * len(images)
    return min(tried, key=lambda lefts: sum(each or 0.0 for each in lefts), default=nothing)
