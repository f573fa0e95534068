"""Refit a learned profile to known presses, and measure its depth error on presses left out of the refit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation.press_observation import placed_indenter
from tacshade_edge.core.calibration.refit import gain
from tacshade_edge.core.calibration.refit.error_scale import error_scale, errors_in_sigma
from tacshade_edge.core.depth import Network, SigmaModel
from tacshade_edge.core.depth.learned import Inverse, LearnedSolver, untrusted_cells
from tacshade_edge.core.frame_check.untrusted import UNTRUSTED_UNLEARNT, untrusted_part
from tacshade_edge.core.geometry.sensor_rays import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import F64, Bool, Calibration, Geometry, ProfileFit


@dataclass(frozen=True, slots=True)
class Refit:
    """A refitted profile: the factor on h, and of each press with the others' factor its name and greatest h found less
    the true one; the greatest h that the network finds without a refit, and the indenter at its stated place; the part
    of the median press's disc that the network cannot explain as this sensor's skin (0 to 1); messages about presses
    left out for that; the factor on σ (None if the network has no model of its errors).
    """

    factor: float
    fit: ProfileFit
    errors_mm: tuple[tuple[str, float], ...]
    found_mm: tuple[float, ...]
    placed: tuple[gain.Placed, ...]
    untrusted_part: float
    left_out: tuple[str, ...]
    error_scale: float | None


def refit_profile(
    calibration: Calibration, profile: Profile, network: Network, presses: Sequence[KnownPress]
) -> Refit | None:
    """Refit a profile; None if its network finds too few of the contacts."""
    geometry = calibration.geometry
    preprocessor = Preprocessor(calibration, profile)
    solver = LearnedSolver(preprocessor, network)
    rows, seen, found_mm, placed, names, parts, left_out = [], [], [], [], [], [], []
    inside = rays_in_image(solver.grid, calibration).inside
    for press in presses:
        inverse = solver.inverse(preprocessor.preprocess(preprocessor.grey(press.image)))
        parts.append(untrusted_part(untrusted_cells(inverse, len(inverse.height_mm)), inside))
        if parts[-1] > UNTRUSTED_UNLEARNT:
            left_out.append(f"{press.name}: {100 * parts[-1]:.0f} % of it does not show this sensor's skin; left out")
            continue
        at = placed_press(geometry, inverse, press)
        row = gain.press_rows(inverse, geometry, at) if at else None
        if at and row:
            rows.append(row)
            seen.append(inverse)
            found_mm.append(inverse.height_mm[inverse.contact_logit > 0].max())
            placed.append(at)
            names.append(press.name)
    factor = gain.fit_factor(rows)
    if factor is None:
        return None
    errors, in_sigma = [], []
    for k, (found, at) in enumerate(zip(found_mm, placed, strict=True)):
        without = gain.fit_factor(rows[:k] + rows[k + 1 :]) or 1.0
        errors.append(float(found * np.float32(without)) - at.depth_max_mm(geometry.skin_radius_mm))
        if network.sigma is not None:
            in_sigma.append(_errors_in_sigma(network.sigma, seen[k], without, at, inside, geometry))
    off = np.abs(errors)
    fit = ProfileFit(len(rows), float(off.mean()), float(off.max()))
    return Refit(
        factor,
        fit,
        tuple(zip(names, errors, strict=True)),
        tuple(float(found) for found in found_mm),
        tuple(placed),
        float(np.median(parts)),
        tuple(left_out),
        None if network.sigma is None else error_scale(network.sigma, in_sigma),
    )


def _errors_in_sigma(
    model: SigmaModel, inverse: Inverse, factor: float, placed: gain.Placed, inside: Bool, geometry: Geometry
) -> F64:
    """error| over σ of scale 1 of a press, at the cells of `gain.press_rows` inside the image."""
    height = np.where(inside, np.maximum(np.nan_to_num(inverse.height_mm * np.float32(factor)), 0), 0)
    truth, use = gain.known_cells(inverse, geometry, placed)
    return errors_in_sigma(
        model, height.astype(np.float32), truth, inverse.contact_logit, inverse.untrusted_logit, use, geometry
    )


def placed_press(geometry: Geometry, inverse: Inverse, press: KnownPress) -> gain.Placed | None:
    """The indenter of a press at its stated place; a ball without one is located, or None if that fails."""
    if press.indenter is not None:
        return placed_indenter(press, press.indenter, geometry)
    return gain.placed_ball(geometry, inverse, press, press.radius_mm)
