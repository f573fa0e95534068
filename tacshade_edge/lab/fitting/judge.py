"""Judge fitted networks by a sensor's presses, or by touches without labels: whether to keep them,
and which factors on heights and on σ they get.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration import refit
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.refit import error_scale, errors_in_sigma, placed_press
from tacshade_edge.lab.fitting import training
from tacshade_edge.lab.fitting.explained import Choice
from tacshade_edge.lab.fitting.torch_network import TorchNetwork
from tacshade_edge.lab.fitting.twin import Frames
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.depth.learned import Inverse, LearnedSolver
from tacshade_edge.sensor.geometry.disc_map import map_grid, rays_in_image
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.inference.network import load_network, shipped_layout
from tacshade_edge.sensor.profiles import PROFILES, Profile
from tacshade_edge.types import F32, Bool, Calibration, FittedNetwork


@dataclass(frozen=True, slots=True)
class OnPresses:
    """A network's errors on presses.

    `errors_mm`: mean error of h for each indenter, at the cells where its surface is known; empty
    if no contact is found. `presses`: presses whose contact the network finds. `factor`: on h;
    other than 1 if every indenter's error, with the factor that the others show, is less in the
    mean: `errors_mm` are then these. `error_scale`: factor on σ; None without presses or a model of
    the network's errors.
    """

    errors_mm: dict[str, float]
    presses: int
    factor: float
    error_scale: float | None

    @property
    def mean_mm(self) -> float:
        """Mean over the indenters, each with the same weight."""
        return float(np.mean(list(self.errors_mm.values())))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A press as a network sees it: the indenter's name, its weight and factor
    (`refit.press_factor`), the answer, its height, the true one, and the cells where both are
    known.
    """

    name: str
    row: tuple[float, float]
    inverse: Inverse
    height_mm: F32
    true_mm: F32
    known: Bool


class JudgingPresses:
    """Presses prepared once for a profile, on which networks are measured."""

    def __init__(
        self, calibration: Calibration, profile: Profile, presses: Sequence[KnownPress]
    ) -> None:
        self._geometry = calibration.geometry
        self._preprocessor = Preprocessor(calibration, profile)
        grid = map_grid(calibration.geometry.disc, profile.cells)
        self._inside = rays_in_image(grid, calibration).inside
        look = self._preprocessor
        self._prepared = [(press, look.preprocess(look.grey(press.image))) for press in presses]

    def measure(self, network: Network, factor: float | None = None) -> OnPresses:
        """Measure a network, with the factor on h that it has, or with one that presses show."""
        seen = self._seen_by(network)
        # By indenter, not by press: an indenter pressed often would otherwise decide.
        names = dict.fromkeys(each.name for each in seen)
        factors = {
            # Left out of its own factor, so that a factor gains only if it holds for what it has
            # not seen.
            name: factor or refit.fit_factor([e.row for e in seen if e.name != name]) or 1.0
            for name in names
        }
        plain, scaled = _errors(seen, dict.fromkeys(names, 1.0)), _errors(seen, factors)
        gains = factor is not None or sum(scaled.values()) < sum(plain.values())
        used = factors if gains else dict.fromkeys(names, 1.0)
        own = (factor or refit.fit_factor([e.row for e in seen]) or 1.0) if gains else 1.0
        return OnPresses(
            errors_mm=scaled if gains else plain,
            presses=len(seen),
            factor=own,
            error_scale=self._error_scale(network, seen, used),
        )

    def _seen_by(self, network: Network) -> list[_Seen]:
        solver, seen = LearnedSolver(self._preprocessor, network), []
        for press, prepared in self._prepared:
            inverse = solver.inverse(prepared)
            at = placed_press(self._geometry, inverse, press)
            # A press that the network does not feel counts as missed, not as wrong.
            if at is None or (row := refit.press_factor(inverse, self._geometry, at)) is None:
                continue
            true_mm, known = refit.known_cells(inverse, self._geometry, at)
            # Cells beyond the picture are made up.
            known &= self._inside
            # Of a few cells, the mean is that of the edge.
            if np.count_nonzero(known) < refit.LEAST_CELLS:
                continue
            found_mm = np.maximum(np.nan_to_num(inverse.height_mm), 0)
            height_mm = np.where(self._inside, found_mm, 0).astype(np.float32)
            ball = f"ball of radius {press.radius_mm:g} mm"
            name = press.indenter.name if press.indenter else ball
            seen.append(_Seen(name, row, inverse, height_mm, true_mm, known))
        return seen

    def _error_scale(
        self, network: Network, seen: Sequence[_Seen], factors: Mapping[str, float]
    ) -> float | None:
        sigma = network.sigma
        if sigma is None or not seen:
            return None
        return error_scale(
            sigma,
            [
                errors_in_sigma(
                    sigma,
                    np.float32(factors[each.name]) * each.height_mm,
                    each.true_mm,
                    each.inverse.contact_logit,
                    each.inverse.untrusted_logit,
                    each.known,
                    self._geometry,
                )
                for each in seen
            ],
        )


def _errors(seen: Sequence[_Seen], factors: Mapping[str, float]) -> dict[str, float]:
    """The mean error of h for each indenter, with its factor; mm."""
    off: dict[str, list[float]] = {each.name: [] for each in seen}
    for each in seen:
        wrong_mm = np.abs(factors[each.name] * each.height_mm - each.true_mm)
        off[each.name].append(float(wrong_mm[each.known].mean()))
    return {name: float(np.mean(errors)) for name, errors in off.items()}


WHOLE_WAY, LENGTH_UNKNOWN = 1.0, 0.5
"""The part of the way from the shipped weights to the trained ones: half of it for white pins,
because nothing at rest shows how long they are. On sensors of other mechanics than the shipped
networks learnt, the whole way is best.
"""
TOLERATED = 1.1
"""How much worse than the shipped network a fitted one may be on presses: they are few and of
simple shapes, and none is dragged.
"""
TOLERATED_LEFT = 1.25
"""How much more of touches than the shipped network a fitted one may leave unexplained. That hardly
ranks networks: on working strangers, fits that left up to 1.19 times as much had 0.53 to 0.94 times
the error. So it stops only a network that explains touches far worse than any of these.
"""
USUAL_LEFT = 0.6
"""The share of touches' changes that maps leave unexplained where σ of the shipped networks is
right: layered skins of the working range leave 0.3, where 0.7 to 0.95 times σ holds 90 %, an oblate
one 1.3, where 1.0 to 1.5 times do.
"""


def error_scales_of(lefts: Mapping[str, float]) -> dict[str, float]:
    """Factors on σ of shipped networks, by the shares of touches' changes
    that their heights leave unexplained.
    """
    return {name: error_scale_of(name, left) for name, left in lefts.items()}


def error_scale_of(name: str, left: float) -> float:
    """Factor on σ of a network, by the share of touches' changes that its heights leave
    unexplained. Errors go with the change that is left, the share with its square. An explained
    change may hide a wrong scale: nothing shrinks σ.
    """
    sigma = load_network(name).sigma
    # Networks without a model of their errors have no σ to scale.
    alone = 1.0 if sigma is None else sigma.scale_without_presses
    return alone * max(1.0, math.sqrt(left / USUAL_LEFT))


@dataclass(frozen=True, slots=True)
class NetworkReport:
    """Errors of a network, as shipped and fitted.

    `name`: a profile. `shipped_mm`, `fitted_mm`: mean error in contact on frames of the twin that
    training did not see. `shipped_presses_mm`, `fitted_presses_mm`: mean error on the sensor's
    presses, from which no network has learnt. None without presses; the second also if the fitted
    network misses more of them. `shipped_left`, `fitted_left`: the share of the touches' changes
    that the heights leave unexplained; None without touches, or where presses judge.
    """

    name: str
    shipped_mm: float
    fitted_mm: float
    shipped_presses_mm: float | None = None
    fitted_presses_mm: float | None = None
    shipped_left: float | None = None
    fitted_left: float | None = None

    @property
    def kept(self) -> bool:
        """Whether the fitted network goes into the calibration: it is better on the twin, and
        tolerable on presses or touches.
        """
        if self.fitted_mm >= self.shipped_mm:
            return False
        if self.shipped_presses_mm is not None:
            found_mm = self.fitted_presses_mm
            return found_mm is not None and found_mm < TOLERATED * self.shipped_presses_mm
        if self.shipped_left is not None and self.fitted_left is not None:
            return self.fitted_left < TOLERATED_LEFT * self.shipped_left
        return True

    @property
    def line(self) -> str:
        """The report as one line of text."""
        off = (
            f"off by {self.fitted_mm:.2f} mm on simulated frames, "
            f"{self.shipped_mm:.2f} mm as shipped"
        )
        line = f"fit of {self.name}: {off}"
        if self.shipped_presses_mm is not None and self.fitted_presses_mm is None:
            line += "; it misses more of your presses"
        elif self.fitted_presses_mm is not None:
            line += (
                f"; {self.fitted_presses_mm:.2f} mm on your presses, "
                f"{self.shipped_presses_mm:.2f} mm as shipped"
            )
        elif self.shipped_left is not None and self.fitted_left is not None:
            left, before = 100 * self.fitted_left, 100 * self.shipped_left
            line += (
                f"; it leaves {left:.0f} % of your touches unexplained, {before:.0f} % as shipped"
            )
        return line if self.kept else f"{line}; that is no better, so the shipped network stays"


def skin_radii(calibration: Calibration) -> float:
    """The disc's radius in skin radii."""
    return math.sin(math.radians(calibration.geometry.visible_half_angle_deg))


def towards(name: str, weights: F32, part: float) -> F32:
    """Weights a part of the way from a shipped network's to trained ones, which began there.

    They keep what the shipped network knows of other skins (M. Wortsman et al., Robust fine-tuning
    of zero-shot models, CVPR 2022).
    """
    shipped = TorchNetwork(name).flat()
    return shipped + np.float32(part) * (weights - shipped)


def judged(
    calibration: Calibration,
    presses: Sequence[KnownPress],
    touches: Choice | None,
    held_out: Sequence[Frames],
    name: str,
    weights: F32,
) -> tuple[FittedNetwork, NetworkReport]:
    """Judge weights by frames of the twin, and by presses, or else by touches.

    `held_out`: frames of the twin that training did not see.
    """
    maps = training.maps_of(calibration, held_out, name)
    unit_mm = calibration.geometry.skin_radius_mm * skin_radii(calibration)
    network = TorchNetwork(name)
    shipped_mm = unit_mm * training.error(network, maps)
    network.load(weights)
    off_mm = unit_mm * training.error(network, maps)
    # Without presses, σ shrinks as the error does on simulated frames.
    sigma = load_network(name).sigma
    scale = None if sigma is None else sigma.scale_without_presses * off_mm / shipped_mm
    layout = shipped_layout(name)
    fitted = FittedNetwork(layout, weights, 0, off_mm, shipped_mm, error_scale=scale)
    report = NetworkReport(name, shipped_mm, off_mm)
    if presses:
        own = calibration.factors.get(name, 1.0)
        pressed = JudgingPresses(calibration, PROFILES[name], presses)
        before = pressed.measure(load_network(name), own)
        if before.errors_mm:
            return _by_presses(pressed, before, fitted, report)
    if touches is not None:
        after = touches.left_by(replace(calibration, fitted={name: fitted}), name)
        report = replace(report, shipped_left=touches.lefts[name], fitted_left=after)
        return with_error_scale(fitted, name, after), report
    return fitted, report


def _by_presses(
    presses: JudgingPresses, before: OnPresses, fitted: FittedNetwork, report: NetworkReport
) -> tuple[FittedNetwork, NetworkReport]:
    after = presses.measure(load_network(report.name, fitted))
    report = replace(report, shipped_presses_mm=before.mean_mm)
    # A network that feels only the deep ones has a smaller mean.
    if after.presses < before.presses:
        return fitted, report
    judged_fit = replace(
        fitted,
        held_out=after.presses,
        error_mm=after.mean_mm,
        shipped_error_mm=before.mean_mm,
        factor=after.factor,
        error_scale=after.error_scale,
    )
    return judged_fit, replace(report, fitted_presses_mm=after.mean_mm)


def with_error_scale(fitted: FittedNetwork, name: str, left: float) -> FittedNetwork:
    """The network with at least the error scale that what it leaves of touches shows."""
    if fitted.error_scale is None:
        return fitted
    # Touches widen σ and never narrow it: an explained change may hide a wrong scale.
    return replace(fitted, error_scale=max(fitted.error_scale, error_scale_of(name, left)))
