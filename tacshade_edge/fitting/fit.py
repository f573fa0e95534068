"""``calibrate --fit`` trains each profile's network further with a sensor's presses and reports whether that helped."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.refit.press_targets import (
    Targets,
    fitted_error_scale,
    held_out,
    known_errors_mm,
    press_targets,
)
from tacshade_edge.core.profiles import DEFAULT, LADDER, PROFILES
from tacshade_edge.errors import ConfigError
from tacshade_edge.fitting import training
from tacshade_edge.fitting.rehearsal import rehearsal
from tacshade_edge.fitting.torch_network import TorchNetwork
from tacshade_edge.inference.network import load_network, network_files, shipped_layout
from tacshade_edge.inference.onnx_weights import values_of
from tacshade_edge.types import Calibration, FittedNetwork

LEAST_PRESSES, ENOUGH_PRESSES = 16, 40
"""`fit` refuses fewer presses than the first; below the second it advises taking more."""
DRAGS = 2
"""Number of times that each press is shown dragged, too."""
GAIN_ELSEWHERE_PCT = {"accurate": 7, "balanced": 3, "fast": 1}
"""How much less error objects have that were not pressed, pressed and dragged, on average over sensors; in percent. The
held-out presses often gain more, because training has seen their shapes (docs/results/fit.md)."""
ORDER = (DEFAULT, *(name for name in LADDER if name != DEFAULT))
"""The default profile's network first."""
_SAY_S = 5.0

Say = Callable[[str], None]
"""Receives a line on the progress and the time left, every few seconds."""


@dataclass(frozen=True, slots=True)
class ProfileReport:
    """Errors of a profile's h on the held-out presses, where the indenter's surface is known.

    Attributes
    ----------
    profile : str
    shipped_mm, fitted_mm : dict of str to float
        Mean error for each indenter; `fitted_mm` is that of the trained network, kept or not.
    shipped_dragged_mm, fitted_dragged_mm : dict of str to float
        The same where the presses are shown dragged; empty if the network recognises none of these pictures.
    """

    profile: str
    shipped_mm: dict[str, float]
    fitted_mm: dict[str, float]
    shipped_dragged_mm: dict[str, float]
    fitted_dragged_mm: dict[str, float]

    @property
    def gain_pct(self) -> float:
        """How much less error the presses have, pressed and dragged together, in percent; negative if more."""
        shipped_mm, fitted_mm = (
            sum(_mean(each) for each in pair if each)
            for pair in ((self.shipped_mm, self.shipped_dragged_mm), (self.fitted_mm, self.fitted_dragged_mm))
        )
        return 100 * (1 - fitted_mm / shipped_mm)

    @property
    def kept(self) -> bool:
        """Whether the trained network goes into the calibration: it is better."""
        return self.gain_pct > 0

    @property
    def line(self) -> str:
        """The report as one line of text."""
        each = ", ".join(f"{name} {error:.2f}" for name, error in sorted(self.fitted_mm.items()))
        dragged = ""
        if self.shipped_dragged_mm:
            now_mm, was_mm = _mean(self.fitted_dragged_mm), _mean(self.shipped_dragged_mm)
            dragged = f"; dragged, {now_mm:.2f} mm, {was_mm:.2f} mm as shipped"
        kept = "; that is no better, so the shipped network stays"
        if self.kept:
            elsewhere_pct = min(self.gain_pct, GAIN_ELSEWHERE_PCT[self.profile])
            kept = f"; expect objects that you did not press to gain {elsewhere_pct:.0f} %"
        return (
            f"fit of {self.profile}: off by {_mean(self.fitted_mm):.2f} mm on held-out presses, "
            f"{_mean(self.shipped_mm):.2f} mm as shipped ({each}){dragged}{kept}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The calibration with the networks that were kept, the profiles' reports, and advice on more presses."""

    calibration: Calibration
    profiles: tuple[ProfileReport, ...]
    advice: tuple[str, ...]


def fit(calibration: Calibration, presses: Sequence[KnownPress], say: Say) -> FitResult:
    """Train every profile's network further.

    Parameters
    ----------
    calibration : Calibration
        Made from these presses, without fitted networks.
    presses : sequence of KnownPress
        The presses that `calibrate` used.
    say : callable

    Raises
    ------
    ConfigError
        There are too few presses, or the networks find the contact in too few of them.
    """
    if len(presses) < LEAST_PRESSES:
        raise ConfigError(
            f"--fit: found {len(presses)} usable presses, "
            f"expected at least {LEAST_PRESSES} ({ENOUGH_PRESSES} give better results)"
        )
    train, judge = held_out(presses)
    runs = [_Run(calibration, name, train, judge) for name in ORDER if name in calibration.factors]
    if not runs:
        raise ConfigError("--fit: the networks find a contact under the indenter in too few presses")
    fitted, reports = {}, []
    for number, run in enumerate(runs):
        _train(run, runs[number + 1 :], f"fit of {run.name} ({number + 1} of {len(runs)})", say)
        made, report = run.result()
        reports.append(report)
        if report.kept:
            fitted[run.name] = made
    return FitResult(replace(calibration, fitted=fitted), tuple(reports), _advice(presses, reports))


class _Run:
    """The training of one profile."""

    def __init__(
        self, calibration: Calibration, name: str, train: Sequence[KnownPress], judge: Sequence[KnownPress]
    ) -> None:
        self.name = name
        self._geometry = calibration.geometry
        profile = PROFILES[name]
        self._weights = profile.network or name
        self._shipped = load_network(self._weights)
        self._factor = calibration.factors[name]
        self._judge = press_targets(calibration, profile, self._shipped, judge, DRAGS)
        trained = press_targets(calibration, profile, self._shipped, train, DRAGS)
        if not _undragged(trained).presses or not _undragged(self._judge).presses:
            raise ConfigError(f"--fit: {name} finds a contact under the indenter in too few presses")
        frame, self._once = network_files(self._weights)
        self._network = TorchNetwork(frame, trained.sensors, self._factor)
        frames = rehearsal(self._shipped, profile.cells)
        self.training = training.Training(self._network, self._shipped.fold, self._factor, trained, frames)

    def result(self) -> tuple[FittedNetwork, ProfileReport]:
        """The trained network and the report on it, measured as it will run."""
        held, sensor = _undragged(self._judge), self._judge.sensors[0]
        correction = np.zeros_like(sensor)
        made = FittedNetwork(
            shipped_layout(self._weights),
            np.concatenate((self._network.flat(), values_of(self._once))),
            correction,
            len(held.presses),
            error_mm=0.0,
            shipped_error_mm=0.0,
        )
        network = load_network(self._weights, made)
        before = known_errors_mm(self._judge, self._shipped, sensor, self._factor)
        after = known_errors_mm(self._judge, network, sensor)
        of_each = [_of_each(self._judge, errors, dragged) for dragged in (False, True) for errors in (before, after)]
        report = ProfileReport(self.name, *of_each)
        scale = fitted_error_scale(held, network, sensor, self._geometry)
        error_mm, shipped_mm = _mean(report.fitted_mm), _mean(report.shipped_mm)
        made = FittedNetwork(made.layout, made.weights, correction, made.held_out, error_mm, shipped_mm, scale)
        return made, report


def _undragged(targets: Targets) -> Targets:
    return replace(targets, presses=tuple(press for press in targets.presses if not press.dragged))


def _train(run: _Run, later: Sequence[_Run], what: str, say: Say) -> None:
    began_s = said_s = time.monotonic()
    later_s = sum(training.STEPS * each.training.step_s for each in later)
    for step in run.training.steps():
        now_s = time.monotonic()
        if now_s - said_s >= _SAY_S:
            said_s = now_s
            left_s = (training.STEPS - step) * (now_s - began_s) / step + later_s
            say(f"{what}: step {step} of {training.STEPS}, {left_s:.0f} s left at most")


def _of_each(targets: Targets, errors_mm: Sequence[float], dragged: bool) -> dict[str, float]:
    """Mean error for each indenter, mm, of the presses that are shown dragged, or of the others."""
    errors = defaultdict(list)
    for press, error in zip(targets.presses, errors_mm, strict=True):
        if press.dragged == dragged:
            errors[press.indenter].append(error)
    return {name: float(np.mean(each)) for name, each in errors.items()}


def _mean(errors_mm: dict[str, float]) -> float:
    """Mean over the indenters, each with the same weight, mm."""
    return float(np.mean(list(errors_mm.values())))


def _advice(presses: Sequence[KnownPress], reports: Sequence[ProfileReport]) -> tuple[str, ...]:
    """Advice on the presses that would help most, the most useful first."""
    advice = []
    if all(press.indenter is None for press in presses):
        advice.append("also press flat ends, a box and a lying bar: balls alone show less of other shapes")
    if len(presses) < ENOUGH_PRESSES:
        advice.append(f"take {ENOUGH_PRESSES - len(presses)} more presses")
    errors = reports[0].fitted_mm
    if len(errors) > 1:
        worst = max(errors, key=lambda name: errors[name])
        advice.append(f"take more presses with {worst}, which is off most ({errors[worst]:.2f} mm)")
    deepest = max(press.depth_mm for press in presses)
    advice.append(
        f"the fit covers no contact deeper than the deepest press, {deepest:.1f} mm: press as deep as you will work"
    )
    return tuple(advice)
