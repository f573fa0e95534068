"""What a network is to say of known presses when it is trained on with them (``calibrate --fit``).

Only where the indenter's surface lies inside the undeformed skin and the shipped network sees contact is h known. The
skin lifts off near the edge of a contact, so there h is at least the indenter's surface; the contact's outline, what is
untrusted, and h far away are to stay what the shipped network says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.refit import gain
from tacshade_edge.core.calibration.refit.error_scale import error_scale, errors_in_sigma
from tacshade_edge.core.calibration.refit.profile_refit import placed_press
from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.learned import Inverse, LearnedSolver, untrusted_cells
from tacshade_edge.core.depth.network_maps import fold, known_maps, scale_mm, unfold
from tacshade_edge.core.frame_check.untrusted import UNTRUSTED_UNLEARNT, untrusted_part
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.sensor_rays import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import F32, Bool, Calibration, Geometry, freeze

_FAR_CELLS = 3
"""Of a map of `disc_map.CELLS`: nearer to a contact h is whatever the skin makes of it."""
_EACH = 5
"""One press of so many is held out."""


VIEWS = tuple((turns, mirrored) for mirrored in (False, True) for turns in range(4))
"""A sensor whose camera is turned, so many quarters, or whose picture is mirrored is as good a sensor, and the disc and
what is known of it are the same: each press is eight. The first is the sensor itself."""


@dataclass(frozen=True, slots=True, eq=False)
class PressTarget:
    """A press as a network sees it, and what it is to say. Heights are in the network's unit, of `cells` a side.

    Attributes
    ----------
    name, indenter : str
    white : float32 (fold², N, N), 0 to 1
        What the network is given.
    surface : float32 (cells, cells)
        h of the indenter's surface; 0 where it does not lie inside the undeformed skin.
    known : bool (cells, cells)
        Where h is the surface's.
    far : bool (cells, cells)
        Far from the contact, inside the disc.
    inside : bool (cells, cells)
        In the picture and the disc.
    height, contact_logit : float32 (cells, cells)
    untrusted_logit : float32 (M, M)
        As the shipped network says.
    """

    name: str
    indenter: str
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
        What the sensor adds to the first layer of the shipped network; then what it would add if its camera were turned
        or its picture mirrored, in the order of `VIEWS`.
    unit_mm : float
        Of the network's heights.
    """

    presses: tuple[PressTarget, ...]
    sensors: tuple[F32, ...]
    unit_mm: float


def press_targets(
    calibration: Calibration, profile: Profile, network: Network, presses: Sequence[KnownPress]
) -> Targets:
    """What the profile's shipped network sees of presses, and is to say of them; without those whose contact it misses.

    Parameters
    ----------
    calibration : Calibration
        Of the sensor, not fitted.
    profile : Profile
    network : Network
        The shipped one.
    presses : sequence of KnownPress
    """
    geometry = calibration.geometry
    preprocessor = Preprocessor(calibration, profile)
    solver = LearnedSolver(preprocessor, network)
    inside = rays_in_image(solver.grid, calibration).inside
    unit_mm = scale_mm(geometry)
    targets = []
    for press in presses:
        seen = preprocessor.preprocess(preprocessor.grey(press.image))
        inverse = solver.inverse(seen)
        at = placed_press(geometry, inverse, press)
        if at is None or untrusted_part(untrusted_cells(inverse, len(inverse.height_mm)), inside) > UNTRUSTED_UNLEARNT:
            continue
        surface: F32 = np.nan_to_num(gain.known_height(geometry, at, len(inverse.height_mm)))
        np.maximum(surface, np.float32(0), out=surface)
        known = (surface > 0) & (inverse.contact_logit > 0) & inside
        if np.count_nonzero(known) < gain.LEAST_CELLS:
            continue
        targets.append(
            PressTarget(
                press.name,
                press.indenter.name if press.indenter else "ball",
                fold(solver.white(seen)[None], network.fold),
                surface / unit_mm,
                known,
                _far(surface > 0, inverse) & inside,
                inside,
                inverse.height_mm / unit_mm,
                inverse.contact_logit,
                inverse.untrusted_logit,
            )
        )
    calibrated = preprocessor.calibration
    sensors = tuple(
        network.sense(
            known_maps(calibrated.geometry, calibrated.pitch_px, seen_as(solver.reference, view), network.fold)
        )
        for view in VIEWS
    )
    return Targets(tuple(targets), sensors, float(unit_mm))


def seen_as(map_: F32, view: tuple[int, bool]) -> F32:
    """A map (cells, cells) as another view of the sensor shows it."""
    turns, mirrored = view
    turned = np.rot90(map_, turns)
    return np.ascontiguousarray(np.fliplr(turned) if mirrored else turned)


def held_out(presses: Sequence[KnownPress]) -> tuple[list[KnownPress], list[KnownPress]]:
    """Presses to train with, and a fifth to judge by: of every indenter, ball and depth as many as there can be."""
    order = sorted(presses, key=lambda p: (p.indenter.name if p.indenter else "", p.radius_mm, p.depth_mm))
    train = [press for k, press in enumerate(order) if k % _EACH != _EACH // 2]
    return train, order[_EACH // 2 :: _EACH]


def known_errors_mm(targets: Targets, network: Network, sensor: F32, factor: float = 1.0) -> list[float]:
    """Of each press the mean error at the cells where h is known.

    Parameters
    ----------
    targets : Targets
    network : Network
    sensor : float32 (channels, N, N)
        What the sensor adds to its first layer.
    factor : float
        On its heights.
    """
    errors = []
    for press in targets.presses:
        folded = network.run(press.white, sensor).depth_and_contact
        height = unfold(folded, network.fold)[0] * np.float32(factor)
        errors.append(float(np.abs(height - press.surface)[press.known].mean()) * targets.unit_mm)
    return errors


def fitted_error_scale(targets: Targets, network: Network, sensor: F32, geometry: Geometry) -> float | None:
    """The scale of the errors of a network on presses that it was not trained with; None where it has no model of them.

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
