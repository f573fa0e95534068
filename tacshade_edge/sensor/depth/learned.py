"""Compute height, contact and shear from the white of the image and the unloaded skin
by learned inverses.

The networks are trained on simulated sensors alone (tools/training). They see every sensor on the
same square of cells (`sensor.geometry.disc_map`), with what is known of it; lengths are in tenths
of the disc's radius. The network of shear, one for all profiles, runs on request and shares nothing
with that of depth, which needs all its few channels. The caller chooses how to run them
(`sensor.inference.network` uses ONNX Runtime).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import cv2
import numpy as np

from tacshade_edge.sensor.depth.solver import Depth, Features, Mark, Network
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc_map import rays_in_image
from tacshade_edge.sensor.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.sensor.image.white import CellMeans
from tacshade_edge.types import F32, Bool, Geometry, frozen

KNOWN = 6  # number of maps of `disc_map.geometry_maps`

HEIGHT_SCALE = 10.0  # number of the networks' units of length in the disc's radius
# On a skin of 20 mm the training presses end at 6.5 mm; deeper ones read 6.2 to 6.9.
DEEPEST_RADII = 0.31


def scale_mm(geometry: Geometry) -> np.float32:
    """The factor from the networks' lengths to mm."""
    return np.float32(geometry.visible_radius_mm / HEIGHT_SCALE)


# Flatter skins than this (pads: 0) are none that the networks learnt from;
# they are told of the flattest of those.
FLAT_DEG, LEARNT_DEG = 25.0, 42.0
# Of flat skins the networks then show greater heights, by this factor at these half angles:
# measured on simulated sensors (tools/studies/flat_skins.py).
_SHOWN_DEG, _SHOWN = (0.0, 20.0), (1.5, 1.9)


def is_flat(geometry: Geometry) -> bool:
    """Whether a skin is flatter than those that the networks learnt from."""
    return geometry.visible_half_angle_deg < FLAT_DEG


def as_learnt(geometry: Geometry) -> Geometry:
    """What the networks are told of a sensor: of a flat skin the flattest dome that they learnt
    from, with the same visible circle as far from the lens.
    """
    if not is_flat(geometry):
        return geometry
    half, d = math.radians(LEARNT_DEG), geometry.camera_distance_mm
    r = geometry.visible_radius_mm / math.sin(half)
    if d is not None:
        # Seen from where the lens is, the circle keeps its size: f and the circle's plane stay.
        d = geometry.f_px * geometry.mm_per_px - r * math.cos(half)
    return Geometry(r, d, LEARNT_DEG, geometry.disc)


def shown_ratio(geometry: Geometry) -> float:
    """The ratio of the heights that the networks show to those of the skin; 1 unless it is flat."""
    if not is_flat(geometry):
        return 1.0
    return float(np.interp(geometry.visible_half_angle_deg, _SHOWN_DEG, _SHOWN))


def known_maps(geometry: Geometry, pitch_px: float, reference_white: F32, by: int) -> F32:
    """The maps of what is known of a sensor, (by² + KNOWN, N / by, N / by)."""
    known = disc_map.geometry_maps(geometry, pitch_px, len(reference_white))
    return np.concatenate((fold(reference_white[None], by), known[:, ::by, ::by]))


def fold(maps: F32, by: int) -> F32:
    """Fold (C, N, N) to (by² C, N/by, N/by): each square of by x by cells becomes by² channels."""
    c, n, _ = maps.shape
    part = n // by
    folded = maps.reshape(c, part, by, part, by).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(folded).reshape(by * by * c, part, part)


def unfold(maps: F32, by: int) -> F32:
    """Invert `fold`: (by² C, N/by, N/by) to (C, N, N)."""
    count, part = len(maps) // by**2, maps.shape[1]
    folded = maps.reshape(count, by, by, part, part)
    made = np.empty((count, part, by, part, by), maps.dtype)
    # Plane by plane: NumPy's copy of the turned view goes value by value.
    for row, col in np.ndindex(by, by):
        made[:, :, row, :, col] = folded[:, row, col]
    return made.reshape(count, by * part, by * part)


class _Prepared:
    """A network prepared for one sensor, from the share of white
    of the unloaded skin on `disc_map.map_grid`.
    """

    def __init__(
        self, network: Network, geometry: Geometry, pitch_px: float, reference_white: F32
    ) -> None:
        self._network = network
        self._mm = scale_mm(geometry)
        self._ratio = np.float32(shown_ratio(geometry))
        known = known_maps(as_learnt(geometry), pitch_px, reference_white, network.fold)
        self._sensor = network.sense(known)

    def _run(self, white: F32, features: Features | None) -> Sequence[F32]:
        """Run the network on a frame's white, float32 (cells, cells), 0 to 1;
        append its features to `features`.
        """
        return self._network.run(fold(white[None], self._network.fold), self._sensor, features)


class LearnedShear(_Prepared):
    """The network of shear, prepared for one sensor."""

    def __call__(self, white: F32, cells: int, features: Features | None = None) -> F32:
        """Shear along x and y in mm, (cells, cells, 2), finite,
        from the share of white of a frame (N, N).
        """
        coarse = np.ascontiguousarray(np.moveaxis(self._run(white, features)[0], 0, 2))
        if not np.isfinite(coarse).all():
            coarse = np.nan_to_num(coarse, posinf=0.0, neginf=0.0)
        coarse *= self._mm
        return cast(F32, cv2.resize(coarse, (cells, cells), interpolation=cv2.INTER_LINEAR))


@frozen
class Inverse:
    """The network's result for a frame, float32 (cells, cells): h, sometimes slightly below 0
    without contact, and the log odds of contact at the map's cells; float32 (M, M) log odds that a
    cell (fewer and wider ones) shows something other than this sensor's skin.
    """

    height_mm: F32
    contact_logit: F32
    untrusted_logit: F32


class LearnedInverse(_Prepared):
    """The network of depth, prepared for one sensor."""

    def __call__(self, white: F32, features: Features | None = None) -> Inverse:
        """The result for a frame's white, float32 (cells, cells), 0 to 1."""
        maps, untrusted = self._run(white, features)
        height, logit = unfold(maps, self._network.fold)
        return Inverse(height * (self._mm / self._ratio), logit, untrusted[0])


class LearnedSolver:
    """Solves by the inverse refitted to the sensor and the contact that it finds, on the network's
    cells; `reference` is the share of white of the unloaded skin. ValueError without a network.
    """

    def __init__(self, preprocessor: Preprocessor, network: Network | None) -> None:
        camera, calibration, profile = (
            preprocessor.camera,
            preprocessor.calibration,
            preprocessor.profile,
        )
        if network is None or network.shear is None:
            raise ValueError(f"profile {profile.name} needs a network")
        self.grid = disc_map.map_grid(camera.geometry.disc, profile.cells)
        self._inside = rays_in_image(self.grid, camera).inside
        self._cells = CellMeans(
            preprocessor.integrator, disc_map.map_grid(calibration.geometry.disc, profile.cells)
        )
        self.reference: F32 = self._cells.means(preprocessor.reference_white) / np.float32(255)
        self._inverse = LearnedInverse(
            network, calibration.geometry, calibration.pitch_px, self.reference
        )
        # Prepared here, so that no frame waits for it.
        shear = network.shear
        whole = disc_map.map_grid(calibration.geometry.disc, shear.cells)
        same = shear.cells == profile.cells
        self._shear_cells = self._cells if same else CellMeans(preprocessor.integrator, whole)
        self.fine_reference: F32 = self._shear_cells.means(
            preprocessor.reference_white
        ) / np.float32(255)
        self.fine_inside = rays_in_image(
            disc_map.map_grid(camera.geometry.disc, shear.cells), camera
        ).inside
        self._shear = LearnedShear(
            shear, calibration.geometry, calibration.pitch_px, self.fine_reference
        )
        # A fitted network has a factor of its own; the calibration's are of the shipped weights.
        fitted = camera.fitted.get(profile.name)
        self._factor = np.float32(
            fitted.factor if fitted else camera.factors.get(profile.name, 1.0)
        )
        # The latest image with its white, and with its fine white:
        # depth and shear may see the same.
        self._latest: tuple[Preprocessed, F32] | None = None
        self._latest_fine: tuple[Preprocessed, F32] | None = None
        self._deepest_mm = np.float32(DEEPEST_RADII * camera.geometry.size_mm)

    def inverse(self, preprocessed: Preprocessed, features: Features | None = None) -> Inverse:
        """The network's result for an image without the refit, for calibration."""
        return self._inverse(self.white(preprocessed), features)

    def white(self, preprocessed: Preprocessed) -> F32:
        """The network's input for an image before folding: float32 (cells, cells), 0 to 1."""
        if self._latest is None or self._latest[0] is not preprocessed:
            self._latest = preprocessed, self._cells.means(preprocessed.white)
        return self._latest[1]

    def fine_white(self, preprocessed: Preprocessed) -> F32:
        """The white on the network of shear's cells, which are as fine for every profile."""
        if self._shear_cells is self._cells:
            return self.white(preprocessed)
        if self._latest_fine is None or self._latest_fine[0] is not preprocessed:
            self._latest_fine = None  # frees it before the next
            self._latest_fine = preprocessed, self._shear_cells.means(preprocessed.white)
        return self._latest_fine[1]

    def solve(
        self, preprocessed: Preprocessed, mark: Mark, features: Features | None = None
    ) -> Depth:
        """Depth and contact of an image on `grid`."""
        inverse = self.inverse(preprocessed, features)
        height = inverse.height_mm * self._factor
        finite = np.isfinite(height)
        repaired_px = finite.size - int(np.count_nonzero(finite))
        # Finite before it is clipped: NumPy's maximum hands a NaN on.
        if repaired_px:
            height = np.where(finite, height, np.float32(0))
        np.maximum(height, np.float32(0), out=height)
        contact: Bool = inverse.contact_logit > 0
        contact &= self._inside
        deep = height > self._deepest_mm
        deep &= contact
        return Depth(
            height,
            contact,
            bool(deep.any()),
            repaired_px,
            untrusted_cells(inverse, len(height)),
            inverse.contact_logit,
            inverse.untrusted_logit,
        )

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> F32:
        """Shear along x and y at the cells of `grid`, mm, float32 (rows, cols, 2), finite, and
        undefined outside the disc; the caller owns the array.
        """
        return self._shear(self.fine_white(preprocessed), self.grid.rows, features)


def untrusted_cells(inverse: Inverse, cells: int) -> Bool:
    """Cells where a frame shows something other than the sensor's skin: bool (cells, cells)."""
    untrusted: Bool = inverse.untrusted_logit > 0
    each = cells // len(untrusted)
    return untrusted.repeat(each, axis=0).repeat(each, axis=1)
