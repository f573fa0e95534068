"""``calibrate --fit``: find a sensor's print, simulate a twin, train the networks on it, keep those that are better."""

from __future__ import annotations

import contextlib
import hashlib
import math
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from tacshade_edge.core.calibration import refit
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.refit import error_scale, errors_in_sigma, placed_press
from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.geometry.disc_map import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import DEFAULT, LADDER, PROFILES, Profile
from tacshade_edge.fitting import training
from tacshade_edge.fitting.identify import MERGED, identify
from tacshade_edge.fitting.prints import PARAMETERS, Found
from tacshade_edge.fitting.training import TorchNetwork
from tacshade_edge.fitting.twin import (
    LEAST_PRESSES,
    Frames,
    Mechanics,
    Steps,
    likely_mechanics,
    simulate,
)
from tacshade_edge.inference.network import load_network, shipped_layout
from tacshade_edge.types import F32, Calibration, FittedNetwork


@dataclass(frozen=True, slots=True)
class OnPresses:
    """A network's errors on presses. `errors_mm`: mean error of h for each indenter, at the cells where its surface is
    known; empty if no contact is found. `presses`: presses whose contact the network finds. `factor`: on h; other than
    1 if every indenter's error, with the factor that the others show, is less in the mean: `errors_mm` are then these.
    `error_scale`: factor on σ; None without presses or a model of the network's errors.
    """

    errors_mm: dict[str, float]
    presses: int
    factor: float
    error_scale: float | None

    @property
    def mean_mm(self) -> float:
        """Mean over the indenters, each with the same weight."""
        return float(np.mean(list(self.errors_mm.values())))


def on_presses(
    calibration: Calibration, profile: Profile, network: Network, presses: Sequence[KnownPress],
    factor: float | None = None,
) -> OnPresses:  # fmt: skip
    """Measure a network on presses, with the factor on h that it has, or with one that they show."""
    geometry, preprocessor = calibration.geometry, Preprocessor(calibration, profile)
    solver = LearnedSolver(preprocessor, network)
    inside = rays_in_image(solver.grid, calibration).inside
    seen = []
    for press in presses:
        inverse = solver.inverse(preprocessor.preprocess(preprocessor.grey(press.image)))
        at = placed_press(geometry, inverse, press)
        if at is None or (row := refit.press_factor(inverse, geometry, at)) is None:
            continue
        truth, use = refit.known_cells(inverse, geometry, at)
        use &= inside
        if np.count_nonzero(use) < refit.LEAST_CELLS:
            continue
        height = np.where(inside, np.maximum(np.nan_to_num(inverse.height_mm), 0), 0).astype(
            np.float32
        )
        name = press.indenter.name if press.indenter else f"ball of radius {press.radius_mm:g} mm"
        seen.append((name, row, inverse, height, truth, use))
    names = dict.fromkeys(name for name, *_ in seen)

    def errors(factors: Mapping[str, float]) -> dict[str, float]:
        off: dict[str, list[float]] = {name: [] for name in names}
        for name, _, _, height, truth, use in seen:
            off[name].append(float(np.abs(factors[name] * height - truth)[use].mean()))
        return {name: float(np.mean(each)) for name, each in off.items()}

    factors = {
        name: factor or refit.fit_factor([row for at, row, *_ in seen if at != name]) or 1.0
        for name in names
    }
    plain, scaled = errors(dict.fromkeys(names, 1.0)), errors(factors)
    gains = factor is not None or sum(scaled.values()) < sum(plain.values())
    in_sigma = [
        errors_in_sigma(
            network.sigma, np.float32(factors[name] if gains else 1) * height, truth, inverse.contact_logit,
            inverse.untrusted_logit, use, geometry,
        )
        for name, _, inverse, height, truth, use in seen
        if network.sigma is not None
    ]  # fmt: skip
    return OnPresses(
        scaled if gains else plain,
        len(seen),
        (factor or refit.fit_factor([row for _, row, *_ in seen]) or 1.0) if gains else 1.0,
        error_scale(network.sigma, in_sigma) if network.sigma is not None and in_sigma else None,
    )


@dataclass(frozen=True, slots=True)
class Effort:
    """Numbers of batches, of them held out, of skins in a batch, of prints that show these, and of steps."""

    batches: int
    held_out: int
    skins: int
    views: int
    steps: int


FULL = Effort(batches=52, held_out=4, skins=13, views=2, steps=1500)
MOST_UNEXPLAINED = 0.75
"""Greatest part of the reference's pattern (RMS) that a print may leave unexplained."""
UNEXPLAINED_ALONE = 0.45
"""The same without presses, which would show whether the networks of a wrong print are worse."""
CONTRADICTED = 1.2
"""Stated sizes are wrong if they leave more than this many times as much unexplained as those found without them: pins
stated a fifth too long or too short leave 1.4 and 1.6 times as much, exact ones 1.0."""
PARTS = (0.25, 0.5, 0.75, 1.0)
"""Parts of the way from the shipped weights to the trained ones, among which presses choose. Weights between them keep
what the shipped network knows of other skins (M. Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).
"""
PART_ALONE = {"accurate": 0.25, "balanced": 0.5, "fast": 0.5}
"""The part without presses that judge: less for networks that know other skins better."""
CLEARLY, TOLERATED = 0.95, 1.1
"""How much better than `PART_ALONE` another part is on presses that is taken instead, and how much worse than the
shipped network a fitted one may be on them: presses are few and of simple shapes, and none is dragged."""
LIKELY = 1.02
"""A kind of print that leaves at most this many times the best one's part unexplained belongs to the cloud. Kinds that
leave more have wrong sizes: a cap on a pin looks like a shorter pin."""
MOST_WORKERS = 4
_SAY_S = 5.0
_SLOW_S = 1800.0
"""Simulating and training take about as long: a fit with one that takes longer than this is over an hour."""
NAMES = (DEFAULT, *(name for name in LADDER if name != DEFAULT))
"""The fitted networks, the default profile's first."""
_COSTS = {"accurate": 1.0, "balanced": 0.4, "fast": 0.15}
"""Relative duration of the trainings: the longest begins."""

Say = Callable[[str], None]
"""Receives a line on the progress and the time left, every few seconds."""


@dataclass(frozen=True, slots=True)
class NetworkReport:
    """Errors of a network, as shipped and fitted.

    `name`: a profile. `shipped_mm`, `fitted_mm`: mean error in contact on frames of the twin that training did not
    see. `shipped_presses_mm`, `fitted_presses_mm`: mean error on the sensor's presses, from which no network has
    learnt. None without presses; the second also if the fitted network misses more of them.
    """

    name: str
    shipped_mm: float
    fitted_mm: float
    shipped_presses_mm: float | None = None
    fitted_presses_mm: float | None = None

    @property
    def kept(self) -> bool:
        """Whether the fitted network goes into the calibration: it is better on the twin, and tolerable on presses."""
        if self.shipped_presses_mm is None:
            return self.fitted_mm < self.shipped_mm
        found_mm = self.fitted_presses_mm
        return (
            self.fitted_mm < self.shipped_mm
            and found_mm is not None
            and found_mm < TOLERATED * self.shipped_presses_mm
        )

    @property
    def line(self) -> str:
        """The report as one line of text."""
        off = f"off by {self.fitted_mm:.2f} mm on simulated frames, {self.shipped_mm:.2f} mm as shipped"
        line = f"fit of {self.name}: {off}"
        if self.shipped_presses_mm is not None and self.fitted_presses_mm is None:
            line += "; it misses more of your presses"
        elif self.fitted_presses_mm is not None:
            line += f"; {self.fitted_presses_mm:.2f} mm on your presses, {self.shipped_presses_mm:.2f} mm as shipped"
        return line if self.kept else f"{line}; that is no better, so the shipped network stays"


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The calibration with the networks that were kept, what was found of the sensor, the reports, advice, and all
    networks, with those that were not kept.
    """

    calibration: Calibration
    found: tuple[str, ...]
    networks: tuple[NetworkReport, ...] = ()
    advice: tuple[str, ...] = ()
    trained: Mapping[str, FittedNetwork] = field(default_factory=dict)


def fit(
    calibration: Calibration,
    presses: Sequence[KnownPress],
    say: Say,
    stated: Mapping[str, float] | None = None,
    folder: Path | None = None,
    mechanics: Mechanics | None = None,
) -> FitResult:
    """Fit every network to a sensor. `calibration`: without fitted networks. `presses`: the presses that `calibrate`
    used; may be empty. `stated`: sizes of the print in mm from its drawing, by the keys of ``print`` in SENSOR.yaml;
    they are not fitted. `folder`: keeps finished steps, so that an interrupted fit goes on; removed at the end.
    `mechanics`: the skin's if they are known.
    """
    effort, stated = FULL, stated or {}
    say("fit: finding the print in the reference")
    prints = identify(calibration, stated)
    if (
        stated
        and prints
        and prints[0].residual > CONTRADICTED * (shown := identify(calibration))[0].residual
    ):
        doubt = (
            f"the stated print leaves {100 * prints[0].residual:.0f} % of the reference unexplained"
        )
        found = f"{doubt}: nothing is fitted; compare print in SENSOR.yaml with what the reference shows:"
        return FitResult(calibration, (found, *_words(shown, Mechanics(), {})))
    if not prints or prints[0].residual > MOST_UNEXPLAINED:
        why = (
            "no pins were found"
            if not prints
            else f"it leaves {100 * prints[0].residual:.0f} % of it unexplained"
        )
        found = f"no known kind of print looks like the reference ({why}): nothing is fitted"
        return FitResult(calibration, (found,))
    if not presses and prints[0].residual > UNEXPLAINED_ALONE:
        doubt = f"{100 * prints[0].residual:.0f} % of the reference unexplained"
        found = f"the likeliest print leaves {doubt}: nothing is fitted without presses that judge the fit"
        return FitResult(calibration, (found,), advice=_advice(Mechanics()))
    prints = [each for each in prints if each.residual <= LIKELY * prints[0].residual]
    say("fit: comparing presses with simulated skins" if presses else "fit: simulating")
    mechanics = mechanics or likely_mechanics(calibration, prints[0], presses)
    with contextlib.ExitStack() as stack:
        folder = folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        steps = Steps(folder, _digest(calibration, presses, stated, mechanics, effort))
        weights = _worked(calibration, prints, mechanics, effort, steps, say)
        held = [
            steps.frames(f"frames-{seed}")
            for seed in range(effort.batches - effort.held_out, effort.batches)
        ]
        judged = {name: _judged(calibration, presses, held, name, weights[name]) for name in NAMES}
        steps.remove()
    return FitResult(
        replace(
            calibration,
            fitted={name: made for name, (made, report) in judged.items() if report.kept},
        ),
        _words(prints, mechanics, stated),
        tuple(report for _, report in judged.values()),
        _advice(mechanics),
        {name: made for name, (made, _) in judged.items()},
    )


def _digest(
    calibration: Calibration, presses: Sequence[KnownPress], stated: Mapping[str, float], mechanics: Mechanics,
    effort: Effort,
) -> str:  # fmt: skip
    digest = hashlib.sha256(
        calibration.reference_white.tobytes() + calibration.reference_grey.tobytes()
    )
    known = (calibration.geometry, calibration.pitch_px, sorted(stated.items()), mechanics, effort)
    digest.update(repr(known).encode())
    for press in presses:
        digest.update(
            press.image.tobytes()
            + repr((press.radius_mm, press.depth_mm, press.x_mm, press.y_mm)).encode()
        )
    for name in LADDER:
        digest.update(shipped_layout(name).encode())
    return digest.hexdigest()


_steps_done: Any = None


def _alone(done: Any) -> None:
    """Prepare a worker: one thread, because the workers share the cores; `done` counts the steps of each training."""
    global _steps_done
    _steps_done = done
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _simulated(
    steps: Steps, name: str, calibration: Calibration, prints: Sequence[Found], mechanics: Mechanics, seed: int,
    effort: Effort,
) -> None:  # fmt: skip
    steps.save_frames(
        name, simulate(calibration, prints, mechanics, seed, effort.skins, effort.views)
    )


def _train(steps: Steps, name: str, number: int, calibration: Calibration, effort: Effort) -> None:
    network = TorchNetwork(name)
    parts = [steps.frames(f"frames-{seed}") for seed in range(effort.batches - effort.held_out)]
    maps = training.maps_of(calibration, parts, name)
    del parts

    def report(step: int) -> None:
        _steps_done[number] = step

    training.train(network, maps, _skin_radii(calibration), effort.steps, report)
    steps.save_weights(name, network.flat())


def _worked(
    calibration: Calibration,
    prints: Sequence[Found],
    mechanics: Mechanics,
    effort: Effort,
    steps: Steps,
    say: Say,
) -> dict[str, F32]:
    """Simulate and train on all cores, but for what is kept; the weights."""
    context = multiprocessing.get_context("spawn")
    names = sorted(NAMES, key=lambda name: -_COSTS[name])
    done = context.Array("i", len(names))
    workers = min(os.cpu_count() or 1, MOST_WORKERS)
    with ProcessPoolExecutor(workers, context, _alone, (done,)) as pool:
        try:
            jobs = [
                pool.submit(_simulated, steps, name, calibration, prints, mechanics, seed, effort)
                for seed in range(effort.batches)
                if not steps.has(name := f"frames-{seed}")
            ]
            _wait(jobs, lambda finished: finished / max(len(jobs), 1), "simulating", say)
            to_train = [name for name in names if not steps.has(name)]
            jobs = [
                pool.submit(_train, steps, name, k, calibration, effort)
                for k, name in enumerate(to_train)
            ]
            cost = effort.steps * sum(_COSTS[name] for name in to_train)
            _wait(
                jobs,
                lambda _: sum(_COSTS[n] * done[k] for k, n in enumerate(to_train)) / cost,
                "training",
                say,
            )
        except BaseException:
            # A training takes minutes: Ctrl-C does not wait for it. What is finished is kept.
            for child in multiprocessing.active_children():
                child.terminate()
            raise
    return {name: steps.weights(name) for name in names}


def _wait(
    jobs: Sequence[Future[None]], part_of: Callable[[int], float], what: str, say: Say
) -> None:
    """Wait for jobs, and say every few seconds which part is done; raise what one of them raised."""
    began_s, slow = time.monotonic(), False
    waiting = set(jobs)
    while waiting:
        finished, waiting = wait(waiting, _SAY_S, "FIRST_EXCEPTION")
        for job in finished:
            job.result()
        part = part_of(len(jobs) - len(waiting))
        if part > 0:
            left_s = (time.monotonic() - began_s) * (1 / part - 1)
            say(f"fit: {what}, {100 * part:.0f} % done, about {left_s:.0f} s left")
            if left_s > _SLOW_S and not slow:
                say(
                    "fit: a desktop is faster: press Ctrl-C, run the same command there on these files, copy the result"
                )
                slow = True


def _skin_radii(calibration: Calibration) -> float:
    return math.sin(math.radians(calibration.geometry.visible_half_angle_deg))


def _judged(
    calibration: Calibration,
    presses: Sequence[KnownPress],
    parts: Sequence[Frames],
    name: str,
    weights: F32,
) -> tuple[FittedNetwork, NetworkReport]:
    """Judge the weights, or with presses the best of `PARTS` of the way to them."""
    maps = training.maps_of(calibration, parts, name)
    unit_mm = calibration.geometry.skin_radius_mm * _skin_radii(calibration)
    network = TorchNetwork(name)
    shipped, shipped_mm = network.flat(), unit_mm * training.error(network, maps)

    def part_of_the_way(part: float) -> FittedNetwork:
        made = shipped + np.float32(part) * (weights - shipped)
        network.load(made)
        off_mm = unit_mm * training.error(network, maps)
        return FittedNetwork(shipped_layout(name), made, 0, off_mm, shipped_mm)

    own = calibration.factors.get(name, 1.0)
    before = (
        on_presses(calibration, PROFILES[name], load_network(name), presses, own)
        if presses
        else None
    )
    if before is None or not before.errors_mm:
        made = part_of_the_way(PART_ALONE[name])
        return made, NetworkReport(name, shipped_mm, made.error_mm)
    tried = {}
    for part in PARTS:
        made = part_of_the_way(part)
        after = on_presses(calibration, PROFILES[name], load_network(name, made), presses)
        found_mm = after.mean_mm if after.presses >= before.presses else None
        report = NetworkReport(name, shipped_mm, made.error_mm, before.mean_mm, found_mm)
        if found_mm is not None:
            made = replace(
                made,
                held_out=after.presses,
                error_mm=found_mm,
                shipped_error_mm=before.mean_mm,
                factor=after.factor,
                error_scale=after.error_scale,
            )
        tried[part] = made, report
    return tried[
        chosen(
            {part: report.fitted_presses_mm for part, (_, report) in tried.items()},
            PART_ALONE[name],
        )
    ]


def chosen(errors_mm: Mapping[float, float | None], alone: float) -> float:
    """The part of the way with the least error on presses, or `alone` if no other is clearly better; an error of None
    counts as the greatest.
    """
    known_mm = {part: math.inf if error is None else error for part, error in errors_mm.items()}
    best = min(known_mm, key=known_mm.__getitem__)
    return best if known_mm[best] < CLEARLY * known_mm[alone] else alone


def _words(
    prints: Sequence[Found], mechanics: Mechanics, stated: Mapping[str, float]
) -> tuple[str, ...]:
    """What was found, in words that a person can check against the drawing."""
    best = prints[0]
    pitch_mm = best.base.pitch_mm
    named = zip(
        ("pins", "tips", "bases", "markers"), ("long", *["in radius"] * 3), PARAMETERS, strict=True
    )
    sizes = []
    for k, (what, how, parameter) in enumerate(named):
        if best.kind.white_tips and what == "markers":
            continue
        key = parameter.replace("_pitches", "_mm")
        if key in stated:
            sizes.append(f"{what} {stated[key]:g} mm {how} as stated")
            continue
        if what == "markers" and best.values[k] == MERGED:
            sizes.append("markers that merge")
            continue
        each = pitch_mm * np.array([found.values[k] for found in prints])
        spread = pitch_mm * math.sqrt(best.cloud()[k, k])
        sizes.append(
            f"{what} {max(each.min() - spread, 0):.2f} to {each.max() + spread:.2f} mm {how}"
        )
    unexplained = f"{100 * best.residual:.0f} % of the pattern unexplained"
    lines = [
        f"found a print of {best.kind.name}, pitch {pitch_mm:.2f} mm: {', '.join(sizes)} ({unexplained})"
    ]
    if mechanics.seen:
        decay = " to ".join(f"{each:.1f}" for each in mechanics.decay_mm)
        friction = " to ".join(f"{each:.1f}" for each in mechanics.friction)
        lines.append(
            f"found that the skin's dent decays over {decay} mm beside a contact, and friction {friction}"
        )
    return tuple(lines)


def _advice(mechanics: Mechanics) -> tuple[str, ...]:
    if mechanics.seen:
        return ()
    return (
        f"press at least {LEAST_PRESSES} balls at stated places: they show how soft the skin is",
    )
