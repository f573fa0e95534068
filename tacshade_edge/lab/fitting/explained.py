"""Hold a height map against its picture: how much of the picture's change it leaves unexplained.

A twin's renderer draws the skin that a map describes. White of the cells that the map predicts,
less that of the predicted skin at rest, should be what the picture shows, less the reference. The
part that is left, of the squares that "no contact" would leave, needs no labels: it chooses prints
and lengths of pins on a user's own touches, and vetoes a network that explains them clearly worse.
It does not rank networks as truth does (`tools.studies.strangers.explained`): a picture does not
show the scale of lengths, pins twice as long move twice as far, and the shear comes from a network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.fitting.patches import LENGTHS_PITCHES, own_picture, renderer_of, with_length
from tacshade_edge.lab.fitting.prints import Found, WhiteMap
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.lab.simulator.skin import Skin, direction_to_chart, node_directions, undeformed
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.types import F32, F64, U8, Calibration, Frame, Geometry, Reconstruction

SMOOTH_CELLS = 4.0
"""Smoothing of the compared white: about a pitch,
because where the edge of one tip lies says little of heights.
"""
LEAST_CHANGE = 0.01
"""RMS of the white's change over the disc below which a picture is no touch to judge by;
noise changes 0.003.
"""
LIKELY = 1.02
"""A print that leaves at most this many times the best one's part of the reference unexplained
belongs to the cloud. Prints that leave more have wrong sizes: a cap on a pin looks like a shorter
pin.
"""
ALIKE = 1.05
"""A likely print explains touches as well as the best one if it leaves at most this many times
as much of them.
"""
JUDGES = tuple(LADDER)
"""The profiles whose maps choose a print."""
_ROUNDS = 5
_FARTHEST = 0.98
_MOVED_MM = 1e-3


def skin_of(geometry: Geometry, made: Reconstruction) -> Skin:
    """The skin that a reconstruction describes.

    Its shear contains the material's whole motion, so the renderer's model must have no `friction`.
    """
    flat = undeformed(geometry.skin_radius_mm)
    directions = node_directions(geometry.skin_radius_mm).astype(np.float64)
    grid, radius_mm = made.height, geometry.skin_radius_mm
    height_mm = np.nan_to_num(grid.height_mm)
    h = np.zeros(flat.height_mm.shape, np.float32)
    cols = rows = h
    # The ray of a node depends on how deep it lies.
    for _ in range(_ROUNDS):
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
    # Material cannot come from beyond the equator, whatever the shear of a network says.
    z = np.sqrt(1 - np.minimum((xy * xy).sum(axis=-1, keepdims=True), _FARTHEST))
    before_mm = _chart(np.concatenate((xy, z), axis=-1), radius_mm)
    # Elsewhere the difference of the two charts is rounding, which would move pins of untouched
    # skin.
    moved = (h > _MOVED_MM) | (np.abs(shear_mm).sum(axis=-1) > _MOVED_MM)
    origin_mm = np.where(moved[..., None], before_mm - _chart(directions, radius_mm), 0)
    return replace(skin, origin_mm=origin_mm.astype(np.float32))


def _chart(directions: F64, radius_mm: float) -> F64:
    return np.stack(direction_to_chart(directions, radius_mm), axis=-1)


class Changes:
    """What pictures of one sensor show beside its reference: the change of the cells' white."""

    def __init__(self, calibration: Calibration) -> None:
        self._white = WhiteMap(calibration)
        self._reference = self._white.reference()
        self.inside = self._white.inside

    def of(self, image: U8) -> F32:
        """The change of white of a picture from the reference, smoothed, float32 (cells, cells)."""
        return _soft(self._white.of(greyscale.to_grey(image)) - self._reference)

    def is_touch(self, change: F32) -> bool:
        """Whether a picture changed enough to judge by."""
        return float(np.sqrt(np.square(change[self.inside]).mean())) >= LEAST_CHANGE


class Twin:
    """Predicts the change that a map of one sensor makes,
    with a print that was found in its reference.
    """

    def __init__(self, calibration: Calibration, found: Found) -> None:
        model, layout = found.at(found.values)
        self._geometry = calibration.geometry
        # Without friction: the shear of a map contains all of the motion already.
        self._renderer = renderer_of(found, replace(model, friction=0.0), layout)
        self._white = WhiteMap(calibration)
        self._at_rest = self._drawn(undeformed(model.skin_radius_mm))

    def left(self, change: F32, made: Reconstruction) -> F32:
        """What a reconstruction leaves of a change, float32 (cells, cells), 0 outside the disc."""
        predicted = _soft(self._drawn(skin_of(self._geometry, made)) - self._at_rest)
        return np.where(self._white.inside, change - predicted, np.float32(0))

    def unexplained(self, change: F32, made: Reconstruction) -> float:
        """The part of a change, by squares, that a reconstruction leaves; 1 without contact."""
        if not made.contact:
            # No contact explains nothing, however little the picture changed.
            return 1.0
        whole = float(np.square(change[self._white.inside]).sum())
        return float(np.square(self.left(change, made)).sum()) / max(whole, 1e-9)

    def _drawn(self, skin: Skin) -> F32:
        return self._white.of(np.clip(self._renderer.draw(skin) + 0.5, 0, 255).astype(np.uint8))


def _soft(cells: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(cells, (0, 0), SMOOTH_CELLS), np.float32)


LEAST_TOUCHES = 8
"""Fewer pictures that changed choose by chance."""


class Touches:
    """Pictures of unlabelled touches, to be held against what networks make of them.

    Those that hardly changed are left out. Raises ConfigError
    (fewer than `LEAST_TOUCHES` are left).
    """

    def __init__(self, calibration: Calibration, images: Sequence[U8]) -> None:
        changes = Changes(calibration)
        seen = [(image, changes.of(image)) for image in images]
        self._seen = [(image, change) for image, change in seen if changes.is_touch(change)]
        if len(self._seen) < LEAST_TOUCHES:
            found_touches = f"found {len(self._seen)} pictures with a touch among {len(images)}"
            raise ConfigError(f"touches: {found_touches}, expected at least {LEAST_TOUCHES}")

    def reconstructed(self, calibration: Calibration, profile: str) -> list[Reconstruction]:
        """Reconstruct the pictures with a profile."""
        made = make_reconstructor(calibration, PROFILES[profile])
        return [made.step(Frame(0, 0, 0, image)) for image, _ in self._seen]

    def left(self, made: Sequence[Reconstruction], twin: Twin) -> float:
        """The mean part of the pictures' changes that reconstructions leave unexplained."""
        pairs = zip(self._seen, made, strict=True)
        return float(np.mean([twin.unexplained(change, each) for (_, change), each in pairs]))


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The prints that explain touches best, the best first, its twin, and the share of the touches'
    changes that the heights of each shipped network leave unexplained with it, by profile.
    """

    prints: tuple[Found, ...]
    lefts: Mapping[str, float]
    twin: Twin
    touches: Touches

    @property
    def left(self) -> float:
        """The mean share over the shipped networks."""
        return float(np.mean(list(self.lefts.values())))

    def left_by(self, calibration: Calibration, profile: str) -> float:
        """The mean part of the touches' changes that a profile's heights leave unexplained."""
        return self.touches.left(self.touches.reconstructed(calibration, profile), self.twin)


def chosen_prints(
    calibration: Calibration, prints: Sequence[Found], images: Sequence[U8], stated: bool = False
) -> Choice | None:
    """Choose, by touches, among the prints that the reference shows and its own patches, white tips
    with pins of several lengths; None without any. What the shipped networks make of the touches is
    right on average, so the length that explains it best is the pins' own, unless it is `stated`.

    Raises ConfigError (too few touches).
    """
    tried = candidates(calibration, prints, stated)
    if not tried:
        return None
    touches = Touches(calibration, images)
    made = {name: touches.reconstructed(calibration, name) for name in JUDGES}

    def held(found: Found) -> Choice:
        twin = Twin(calibration, found)
        lefts = {name: touches.left(each, twin) for name, each in made.items()}
        return Choice((found,), lefts, twin, touches)

    # First each print at its best length: only then are prints compared.
    choices = [min(map(held, lengths), key=lambda each: each.left) for lengths in tried]
    choices.sort(key=lambda each: each.left)
    best = choices[0]
    alike = [
        found
        for choice in choices[1:]
        for found in choice.prints
        # Both must agree: touches hardly see the markers, the reference not the length.
        if choice.left <= ALIKE * best.left and found.residual <= LIKELY * best.prints[0].residual
    ]
    return replace(best, prints=(*best.prints, *alike))


def candidates(
    calibration: Calibration, prints: Sequence[Found], stated: bool = False
) -> list[list[Found]]:
    """The prints and the reference's own patches, those of white tips with each of
    `LENGTHS_PITCHES`, unless the length of their pins is stated.
    """
    own = own_picture(calibration)
    made = []
    for found in [*prints, *([own] if own else [])]:
        # Patches have no drawing: what is stated belongs to another kind of print.
        known = stated and not found.kind.patches
        # The reference shows how long dark pins are, by their sides, and of white ones only the
        # tips.
        free = found.kind.white_tips and not known
        made.append([with_length(found, length) for length in LENGTHS_PITCHES] if free else [found])
    return made


def shares_left(
    calibration: Calibration, prints: Sequence[Found], profile: str, images: Sequence[U8]
) -> list[float | None]:
    """The share of each picture's change that a profile's heights leave unexplained, by the print
    that explains all pictures best; None for a picture that hardly changed, and for all without a
    print.
    """
    changes = Changes(calibration)
    reconstructor = make_reconstructor(calibration, PROFILES[profile])
    seen = {
        k: change for k, image in enumerate(images) if changes.is_touch(change := changes.of(image))
    }
    made = {k: reconstructor.step(Frame(0, 0, 0, images[k])) for k in seen}

    def left_by(found: Found) -> Mapping[int, float]:
        twin = Twin(calibration, found)
        return {k: twin.unexplained(change, made[k]) for k, change in seen.items()}

    tried = [left_by(found) for each in candidates(calibration, prints) for found in each]
    # One print for all pictures: each would otherwise choose the one that flatters it.
    best = min(tried, key=lambda lefts: sum(lefts.values()), default={})
    return [best.get(k) for k in range(len(images))]
