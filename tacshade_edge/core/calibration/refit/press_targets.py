"""Training targets for a network from known presses (``calibrate --fit``).

h is known only where the indenter's surface lies inside the undeformed skin and the shipped network sees contact. The
skin lifts off near the edge of a contact, so there h is at least the indenter's surface. The contact's outline, the
untrusted cells and h far away should stay as in the shipped network.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.refit import gain
from tacshade_edge.core.calibration.refit.dragged import (
    Drag,
    dragged_map,
    dragged_picture,
    moved_part,
    pixels_of,
    random_drags,
)
from tacshade_edge.core.calibration.refit.error_scale import error_scale, errors_in_sigma
from tacshade_edge.core.calibration.refit.profile_refit import placed_press
from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.learned import Inverse, LearnedSolver, untrusted_cells
from tacshade_edge.core.depth.network_maps import fold, known_maps, scale_mm, unfold
from tacshade_edge.core.frame_check.untrusted import UNTRUSTED_UNLEARNT, untrusted_part
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.sensor_rays import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import F32, U8, Bool, Calibration, Geometry, freeze

_FAR_CELLS = 3
"""Least distance from a contact, on a map of `disc_map.CELLS`, at which h has a target; nearer, h is free."""
_MOSTLY, _NO_CONTACT = 0.75, -8.0
"""Least part of a dragged cell that h must be known in, and the log odds of contact beyond the map."""
_EACH = 5
"""One press in this many is held out."""


VIEWS = tuple((turns, mirrored) for mirrored in (False, True) for turns in range(4))
"""Quarter turns of the camera, and whether the image is mirrored: each makes another valid sensor with the same disc
and geometry, so each press counts as eight. The first is the sensor itself."""


@dataclass(frozen=True, slots=True, eq=False)
class PressTarget:
    """The network's input for a press, and its targets: maps of `cells` a side, heights in the network's unit.

    Attributes
    ----------
    name, indenter : str
    dragged : bool
        Whether the picture is `dragged`.
    white : float32 (fold², N, N), 0 to 1
        Input of the network.
    surface : float32 (cells, cells)
        h of the indenter's surface; 0 where it is not inside the undeformed skin.
    known : bool (cells, cells)
        Cells where h is the surface's.
    far : bool (cells, cells)
        Cells far from the contact, inside the disc.
    inside : bool (cells, cells)
        Cells inside the image and the disc.
    height, contact_logit : float32 (cells, cells)
    untrusted_logit : float32 (M, M)
        Output of the shipped network, like the two above.
    """

    name: str
    indenter: str
    dragged: bool
    white: F32
    surface: F32
    known: Bool
    far: Bool
    inside: Bool
    height: F32
    contact_logit: F32
    untrusted_logit: F32

    def __post_init__(self) -> None:
        arrays = ("white", "surface", "known", "far", "inside", "height", "contact_logit", "untrusted_logit")
        freeze(self, *arrays)


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """The presses of a sensor for a profile.

    Attributes
    ----------
    presses : tuple of PressTarget
    sensors : tuple of float32 (channels, N, N)
        The sensor's contribution to the first layer of the shipped network, for each of `VIEWS`.
    unit_mm : float
        Unit of the network's heights.
    """

    presses: tuple[PressTarget, ...]
    sensors: tuple[F32, ...]
    unit_mm: float


def press_targets(
    calibration: Calibration, profile: Profile, network: Network, presses: Sequence[KnownPress], drags: int = 0
) -> Targets:
    """Make targets from presses and the profile's shipped network, without presses that it misses.

    Parameters
    ----------
    calibration : Calibration
        Calibration of the sensor, not fitted.
    profile : Profile
    network : Network
        The shipped network.
    presses : sequence of KnownPress
    drags : int
        Number of times that each press is shown dragged, too (`dragged`). The same presses are dragged in the same way.
    """
    maker = _TargetMaker(calibration, profile, network)
    rng = np.random.default_rng(0)
    targets = []
    for press in presses:
        for drag in (None, *random_drags(calibration.geometry, drags, rng)):
            target = maker.target(press, drag)
            if target is not None:
                targets.append(target)
    return Targets(tuple(targets), maker.sensors(), maker.unit_mm)


class _TargetMaker:
    """Makes targets for a network from presses of one sensor."""

    def __init__(self, calibration: Calibration, profile: Profile, network: Network) -> None:
        self._calibration, self._network = calibration, network
        self._preprocessor = Preprocessor(calibration, profile)
        self._solver = LearnedSolver(self._preprocessor, network)
        self._inside = rays_in_image(self._solver.grid, calibration).inside
        self.unit_mm = float(scale_mm(calibration.geometry))

    def sensors(self) -> tuple[F32, ...]:
        """See `Targets`."""
        calibrated, network = self._preprocessor.calibration, self._network
        return tuple(
            network.sense(
                known_maps(
                    calibrated.geometry, calibrated.pitch_px, seen_as(self._solver.reference, view), network.fold
                )
            )
            for view in VIEWS
        )

    def target(self, press: KnownPress, drag: Drag | None) -> PressTarget | None:
        """The target of a press; None if the network misses its contact, or does not recognise the skin."""
        geometry = self._calibration.geometry
        seen, inverse = self._read(press.image)
        at = placed_press(geometry, inverse, press)
        if at is None or not self._recognised(inverse):
            return None
        surface: F32 = np.nan_to_num(gain.known_height(geometry, at, len(inverse.height_mm)))
        np.maximum(surface, np.float32(0), out=surface)
        known = (surface > 0) & (inverse.contact_logit > 0) & self._inside
        contact_logit = inverse.contact_logit
        if drag is not None and np.count_nonzero(known) >= gain.LEAST_CELLS:
            grid = self._solver.grid
            part = moved_part(pixels_of(known, grid, press.image.shape[:2]), geometry.disc, drag)
            seen, inverse = self._read(dragged_picture(press.image, part, drag))
            if not self._recognised(inverse):
                return None
            surface = dragged_map(surface, part, drag, grid, 0)
            known = (dragged_map(known.astype(np.float32), part, drag, grid, 0) > _MOSTLY) & self._inside
            contact_logit = dragged_map(contact_logit, part, drag, grid, _NO_CONTACT)
        if np.count_nonzero(known) < gain.LEAST_CELLS:
            return None
        return PressTarget(
            press.name,
            press.indenter.name if press.indenter else "ball",
            drag is not None,
            fold(self._solver.white(seen)[None], self._network.fold),
            surface / np.float32(self.unit_mm),
            known,
            _far(surface > 0, inverse) & self._inside,
            self._inside,
            inverse.height_mm / np.float32(self.unit_mm),
            contact_logit,
            inverse.untrusted_logit,
        )

    def _read(self, image: U8) -> tuple[Preprocessed, Inverse]:
        seen = self._preprocessor.preprocess(self._preprocessor.grey(image))
        return seen, self._solver.inverse(seen)

    def _recognised(self, inverse: Inverse) -> bool:
        untrusted = untrusted_cells(inverse, len(inverse.height_mm))
        return untrusted_part(untrusted, self._inside) <= UNTRUSTED_UNLEARNT


def seen_as(map_: F32, view: tuple[int, bool]) -> F32:
    """A map (cells, cells) as another view of the sensor shows it."""
    turns, mirrored = view
    turned = np.rot90(map_, turns)
    return np.ascontiguousarray(np.fliplr(turned) if mirrored else turned)


def held_out(presses: Sequence[KnownPress]) -> tuple[list[KnownPress], list[KnownPress]]:
    """Split presses into those to train with and a fifth to test with, both spread over indenters, balls and depths."""
    order = sorted(presses, key=lambda p: (p.indenter.name if p.indenter else "", p.radius_mm, p.depth_mm))
    train = [press for k, press in enumerate(order) if k % _EACH != _EACH // 2]
    return train, order[_EACH // 2 :: _EACH]


def known_errors_mm(targets: Targets, network: Network, sensor: F32, factor: float = 1.0) -> list[float]:
    """The mean absolute error of each press at the cells with known h, mm.

    Parameters
    ----------
    targets : Targets
    network : Network
    sensor : float32 (channels, N, N)
        What the sensor adds to its first layer.
    factor : float
        Factor on its heights.
    """
    errors = []
    for press in targets.presses:
        folded = network.run(press.white, sensor).depth_and_contact
        height = unfold(folded, network.fold)[0] * np.float32(factor)
        errors.append(float(np.abs(height - press.surface)[press.known].mean()) * targets.unit_mm)
    return errors


def fitted_error_scale(targets: Targets, network: Network, sensor: F32, geometry: Geometry) -> float | None:
    """The error scale of a network from presses left out of its training; None if it has no model of its errors.

    Parameters
    ----------
    targets : Targets
        At least one press.
    network : Network
    sensor : float32 (channels, N, N)
        What the sensor adds to its first layer.
    geometry : Geometry
    """
    if network.sigma is None:
        return None
    unit_mm, errors = np.float32(targets.unit_mm), []
    for press in targets.presses:
        maps = network.run(press.white, sensor)
        height, contact_logit = unfold(maps.depth_and_contact, network.fold)
        height_mm = np.where(press.inside, np.maximum(height, 0), np.float32(0)) * unit_mm
        errors.append(
            errors_in_sigma(
                network.sigma, height_mm, press.surface * unit_mm, contact_logit, maps.untrusted, press.known, geometry
            )
        )
    return error_scale(network.sigma, errors)


def _far(under: Bool, inverse: Inverse) -> Bool:
    by = max(1, round(_FAR_CELLS * len(under) / disc_map.CELLS))
    near = (under | (inverse.contact_logit > 0)).astype(np.uint8)
    return np.asarray(cv2.dilate(near, np.ones((2 * by + 1, 2 * by + 1), np.uint8)) == 0)
