"""``calibrate --fit``: find a sensor's print, simulate a twin, train the networks on it,
keep those that are better.
"""

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

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.profiles import DEFAULT, LADDER
from tacshade_edge.fitting import training
from tacshade_edge.fitting.explained import LEAST_TOUCHES, LIKELY, Choice, chosen_prints
from tacshade_edge.fitting.identify import MERGED, identify
from tacshade_edge.fitting.judge import (
    LENGTH_UNKNOWN,
    WHOLE_WAY,
    NetworkReport,
    error_scales_of,
    judged,
    skin_radii,
)
from tacshade_edge.fitting.prints import PARAMETERS, Found
from tacshade_edge.fitting.training import TorchNetwork
from tacshade_edge.fitting.twin import (
    LEAST_PRESSES,
    Mechanics,
    Steps,
    likely_mechanics,
    simulate,
)
from tacshade_edge.inference.network import shipped_layout
from tacshade_edge.types import F32, U8, Calibration, FittedNetwork


@dataclass(frozen=True, slots=True)
class Effort:
    """Numbers of batches, of them held out, of skins in a batch, of prints that show these,
    and of steps.
    """

    batches: int
    held_out: int
    skins: int
    views: int
    steps: int


FULL = Effort(batches=52, held_out=4, skins=13, views=2, steps=1500)
UNEXPLAINED_ALONE = 0.45
"""Greatest part of the reference's pattern (RMS) that a print may leave unexplained without touches
or presses, which would show whether the networks of a wrong print are worse.
"""
MOST_LEFT = 0.9
"""Greatest part of the touches' changes that the best print may leave unexplained:
no print moves like those pins.
"""
CONTRADICTED = 1.2
"""Stated sizes are wrong if they leave more than this many times as much unexplained as those found
without them: pins stated a fifth too long or too short leave 1.4 and 1.6 times as much, exact ones
1.0.
"""
MORE_TOUCHES = (
    "record twenty touches of anything (`capture` does) and repeat with --touches: "
    "they choose the print and judge the fit"
)
MOST_WORKERS = 4
_SAY_S = 5.0
_SLOW_S = 1800.0
"""Simulating and training take about as long: a fit with one that takes longer
than this is over an hour.
"""
NAMES = (DEFAULT, *(name for name in LADDER if name != DEFAULT))
"""The fitted networks, the default profile's first."""
_COSTS = {"accurate": 1.0, "balanced": 0.4, "fast": 0.15}
"""Relative duration of the trainings: the longest begins."""

Say = Callable[[str], None]
"""Receives a line on the progress and the time left, every few seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The calibration with the networks that were kept, what was found of the sensor, the reports,
    advice, and all networks, with those that were not kept.
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
    touches: Sequence[U8] = (),
) -> FitResult:
    """Fit every network to a sensor.

    `calibration`: without fitted networks. `presses`: the presses that `calibrate` used; may be
    empty. `stated`: sizes of the print in mm from its drawing, by the keys of ``print`` in
    SENSOR.yaml; they are not fitted. `folder`: keeps finished steps, so that an interrupted fit
    goes on; removed at the end. `mechanics`: the skin's if they are known. `touches`: pictures of
    touches without labels, which choose the print and judge the networks where there are no
    presses. Raises ConfigError (too few of the touches show a touch).
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
        found = (
            f"{doubt}: nothing is fitted; compare print in SENSOR.yaml with what the reference "
            "shows:"
        )
        return FitResult(calibration, (found, *_words(shown, Mechanics(), {})))
    choice = None
    pictures = touches or [press.image for press in presses]
    if touches or len(pictures) >= LEAST_TOUCHES:
        say("fit: comparing prints with the touches")
        choice = chosen_prints(calibration, prints, pictures, "pin_length_mm" in stated)
    if choice and touches and not calibration.error_scales:
        calibration = replace(calibration, error_scales=error_scales_of(choice.lefts))
    refused = _refused(prints, choice)
    if refused:
        return FitResult(calibration, refused[:1], advice=refused[1:])
    prints = (
        list(choice.prints)
        if choice
        else [each for each in prints if each.residual <= LIKELY * prints[0].residual]
    )
    say("fit: comparing presses with simulated skins" if presses else "fit: simulating")
    mechanics = mechanics or likely_mechanics(calibration, prints[0], presses)
    with contextlib.ExitStack() as stack:
        folder = folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        steps = Steps(folder, _digest(calibration, presses, prints, mechanics, effort))
        weights = _worked(calibration, prints, mechanics, effort, steps, say)
        held = [
            steps.frames(f"frames-{seed}")
            for seed in range(effort.batches - effort.held_out, effort.batches)
        ]
        unlabelled = choice if touches else None
        alone = LENGTH_UNKNOWN if prints[0].kind.white_tips else WHOLE_WAY
        made = {
            name: judged(calibration, presses, unlabelled, held, name, weights[name], alone)
            for name in NAMES
        }
        steps.remove()
    left = (
        ()
        if choice is None
        else (f"it leaves {100 * choice.left:.0f} % of the touches' changes unexplained",)
    )
    return FitResult(
        replace(
            calibration,
            fitted={name: network for name, (network, report) in made.items() if report.kept},
        ),
        (*_words(prints, mechanics, stated), *left),
        tuple(report for _, report in made.values()),
        _advice(mechanics, touches=bool(pictures)),
        {name: network for name, (network, _) in made.items()},
    )


def _refused(prints: Sequence[Found], choice: Choice | None) -> tuple[str, ...]:
    """Why nothing is fitted, and then what a person can do about it; empty without a reason."""
    if choice is not None:
        if choice.left <= MOST_LEFT:
            return ()
        left = (
            f"the best print leaves {100 * choice.left:.0f} % of the touches' changes unexplained"
        )
        return (
            f"{left}: nothing is fitted",
            (
                "compare skin_radius_mm, camera_distance_mm and the visible circle with the "
                "sensor's drawing"
            ),
        )
    if not prints:
        return (
            (
                "no known kind of print looks like the reference (no pins were found): "
                "nothing is fitted"
            ),
            MORE_TOUCHES,
        )
    if prints[0].residual > UNEXPLAINED_ALONE:
        doubt = f"{100 * prints[0].residual:.0f} % of the reference unexplained"
        return (
            (
                f"the likeliest print leaves {doubt}: "
                "nothing is fitted without touches that judge the fit"
            ),
            MORE_TOUCHES,
        )
    return ()


def _digest(
    calibration: Calibration,
    presses: Sequence[KnownPress],
    prints: Sequence[Found],
    mechanics: Mechanics,
    effort: Effort,
) -> str:
    digest = hashlib.sha256(
        calibration.reference_white.tobytes() + calibration.reference_grey.tobytes()
    )
    found = [(each.kind, each.values.tolist(), each.deviations.tolist()) for each in prints]
    known = (calibration.geometry, calibration.pitch_px, found, mechanics, effort)
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
    """Prepare a worker: one thread, because the workers share the cores;
    `done` counts the steps of each training.
    """
    global _steps_done
    _steps_done = done
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _simulated(
    steps: Steps,
    name: str,
    calibration: Calibration,
    prints: Sequence[Found],
    mechanics: Mechanics,
    seed: int,
    effort: Effort,
) -> None:
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

    training.train(network, maps, skin_radii(calibration), effort.steps, report)
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
    """Wait for jobs, and say every few seconds which is done; raise what one of them raised."""
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
                    "fit: a desktop is faster: press Ctrl-C, run the same command there on these "
                    "files, copy the result"
                )
                slow = True


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
        (
            f"found a print of {best.kind.name}, pitch {pitch_mm:.2f} mm: {', '.join(sizes)} "
            f"({unexplained})"
        )
        if not best.kind.patches
        else f"took the tips from the sensor's own picture: pitch {pitch_mm:.2f} mm, {sizes[0]}"
    ]
    if mechanics.seen:
        decay = " to ".join(f"{each:.1f}" for each in mechanics.decay_mm)
        friction = " to ".join(f"{each:.1f}" for each in mechanics.friction)
        lines.append(
            f"found that the skin's dent decays over {decay} mm beside a contact, "
            f"and friction {friction}"
        )
    return tuple(lines)


def _advice(mechanics: Mechanics, touches: bool) -> tuple[str, ...]:
    balls = f"press at least {LEAST_PRESSES} balls at stated places: they show how soft the skin is"
    return (*(() if mechanics.seen else (balls,)), *(() if touches else (MORE_TOUCHES,)))
