"""Judge a network on a sensor's presses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration import refit
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.refit import error_scale, errors_in_sigma, placed_press
from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.geometry.disc_map import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import F64, Calibration


@dataclass(frozen=True, slots=True)
class OnPresses:
    """A network's errors on presses, without a factor. `errors_mm`: mean error of h for each indenter, at the cells
    where its surface is known; empty if no contact is found. `presses`: presses whose contact the network finds.
    `error_scale`: factor on σ; None without presses or a model of the network's errors.
    """

    errors_mm: dict[str, float]
    presses: int
    error_scale: float | None

    @property
    def mean_mm(self) -> float:
        """Mean over the indenters, each with the same weight."""
        return float(np.mean(list(self.errors_mm.values())))


def on_presses(
    calibration: Calibration, profile: Profile, network: Network, presses: Sequence[KnownPress]
) -> OnPresses:
    """Measure a network on presses."""
    geometry, preprocessor = calibration.geometry, Preprocessor(calibration, profile)
    solver = LearnedSolver(preprocessor, network)
    inside = rays_in_image(solver.grid, calibration).inside
    errors: dict[str, list[float]] = defaultdict(list)
    in_sigma: list[F64] = []
    for press in presses:
        inverse = solver.inverse(preprocessor.preprocess(preprocessor.grey(press.image)))
        at = placed_press(geometry, inverse, press)
        if at is None:
            continue
        truth, use = refit.known_cells(inverse, geometry, at)
        use &= inside
        if np.count_nonzero(use) < refit.LEAST_CELLS:
            continue
        height = np.where(inside, np.maximum(np.nan_to_num(inverse.height_mm), 0), 0).astype(np.float32)
        errors[press.indenter.name if press.indenter else "ball"].append(float(np.abs(height - truth)[use].mean()))
        if network.sigma is not None:
            in_sigma.append(
                errors_in_sigma(
                    network.sigma, height, truth, inverse.contact_logit, inverse.untrusted_logit, use, geometry
                )
            )
    scale = error_scale(network.sigma, in_sigma) if network.sigma is not None and in_sigma else None
    count = sum(map(len, errors.values()))
    return OnPresses({name: float(np.mean(each)) for name, each in errors.items()}, count, scale)
