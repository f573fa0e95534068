"""``calibrate --fit``: find a sensor's print, simulate a twin, train the networks on it, keep those that are better."""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.profiles import DEFAULT, LADDER, PROFILES
from tacshade_edge.fitting import training
from tacshade_edge.fitting.identify import PARAMETERS, Found, identify
from tacshade_edge.fitting.judging import on_presses
from tacshade_edge.fitting.mechanics import LEAST_PRESSES, Mechanics, likely_mechanics
from tacshade_edge.fitting.torch_network import TorchNetwork
from tacshade_edge.fitting.twin import Frames, simulate
from tacshade_edge.inference.network import SHEAR, load_network, network_files, network_size, shipped_layout
from tacshade_edge.inference.onnx_weights import weights_of
from tacshade_edge.types import F32, Calibration, FittedNetwork


@dataclass(frozen=True, slots=True)
class Effort:
    """Numbers of domes (of skins' mechanics), of them held out, of skins of each, of prints that show it, of steps."""

    domes: int
    held_out: int
    skins: int
    views: int
    steps: int


FULL = Effort(domes=52, held_out=4, skins=13, views=2, steps=1500)
MOST_UNEXPLAINED = 0.75
"""Greatest part of the reference's pattern (RMS) that a print may leave unexplained."""
LIKELY = 1.15
"""A kind of print that leaves at most this many times the best one's part unexplained belongs to the cloud."""
LEAST_GAIN = 0.15
"""Part by which a network must be better on the twin where no presses judge it, because the twin flatters it: on one
sensor, networks that were 9 and 12 % better on their twin were worse on the sensor; from 14 % on, they were better."""
MOST_WORKERS = 4
_SAY_S = 5.0
_COSTS = {"accurate": 1.0, "shear": 1.2, "balanced": 0.4, "fast": 0.15}
"""Relative duration of the trainings: the longest begins."""

Say = Callable[[str], None]
"""Receives a line on the progress and the time left, every few seconds."""


@dataclass(frozen=True, slots=True)
class NetworkReport:
    """Errors of a network, as shipped and fitted.

    Attributes
    ----------
    name : str
        A profile, or `SHEAR`.
    shipped_mm, fitted_mm : float
        Mean error in contact on frames of the twin that training did not see.
    shipped_presses_mm, fitted_presses_mm : float or None
        Mean error on the sensor's presses, from which no network has learnt; None without presses.
    """

    name: str
    shipped_mm: float
    fitted_mm: float
    shipped_presses_mm: float | None = None
    fitted_presses_mm: float | None = None

    @property
    def kept(self) -> bool:
        """Whether the fitted network goes into the calibration: it is better on the twin, and on presses if any."""
        if self.shipped_presses_mm is not None and self.fitted_presses_mm is not None:
            return self.fitted_mm < self.shipped_mm and self.fitted_presses_mm < self.shipped_presses_mm
        return self.fitted_mm < (1 - LEAST_GAIN) * self.shipped_mm

    @property
    def line(self) -> str:
        """The report as one line of text."""
        off = f"off by {self.fitted_mm:.2f} mm on simulated frames, {self.shipped_mm:.2f} mm as shipped"
        line = f"fit of {self.name}: {off}"
        if self.fitted_presses_mm is not None:
            line += f"; {self.fitted_presses_mm:.2f} mm on your presses, {self.shipped_presses_mm:.2f} mm as shipped"
        return line if self.kept else f"{line}; that is no better, so the shipped network stays"


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The calibration with the networks that were kept, what was found of the sensor, the reports, and advice."""

    calibration: Calibration
    found: tuple[str, ...]
    networks: tuple[NetworkReport, ...]
    advice: tuple[str, ...]


def fit(
    calibration: Calibration,
    presses: Sequence[KnownPress],
    say: Say,
    stated: Mapping[str, float] | None = None,
    folder: Path | None = None,
) -> FitResult:
    """Fit every network to a sensor.

    Parameters
    ----------
    calibration : Calibration
        Without fitted networks.
    presses : sequence of KnownPress
        The presses that `calibrate` used; may be empty.
    say : callable
    stated : mapping of str to float, optional
        Sizes of the print in mm from its drawing, by the keys of ``print`` in SENSOR.yaml; they are not fitted.
    folder : Path, optional
        Keeps finished steps, so that an interrupted fit goes on; removed at the end.
    """
    effort = FULL
    kept = _Kept(folder, _digest(calibration, presses, stated or {}, effort))
    say("fit: finding the print in the reference")
    prints = identify(calibration, stated or {})
    if not prints or prints[0].residual > MOST_UNEXPLAINED:
        why = "no pins were found" if not prints else f"it leaves {100 * prints[0].residual:.0f} % of it unexplained"
        found = f"no known kind of print looks like the reference ({why}): nothing is fitted"
        return FitResult(calibration, (found,), (), ())
    prints = [each for each in prints if each.residual <= LIKELY * prints[0].residual]
    say("fit: comparing presses with simulated skins" if presses else "fit: simulating")
    mechanics = likely_mechanics(calibration, prints[0], presses)
    jobs = [(calibration, prints, mechanics, seed, effort) for seed in range(effort.domes)]
    context = multiprocessing.get_context("spawn")
    names = sorted((*LADDER, SHEAR), key=lambda name: -_COSTS[name])
    done = context.Array("i", len(names))
    workers = min(os.cpu_count() or 1, MOST_WORKERS)
    with ProcessPoolExecutor(workers, context, _alone, (done,)) as pool:
        parts = _frames(pool, jobs, kept, say)
        weights = _trained(pool, calibration, parts, names, effort, done, kept, say)
    fitted, reports = {}, []
    for name in (DEFAULT, *(name for name in (*LADDER, SHEAR) if name != DEFAULT)):
        made, report = _judged(calibration, presses, parts[-effort.held_out :], name, weights[name])
        reports.append(report)
        if report.kept:
            fitted[name] = made
    kept.remove()
    return FitResult(
        replace(calibration, fitted=fitted), _words(prints, mechanics, stated or {}), tuple(reports), _advice(mechanics)
    )


class _Kept:
    """Finished steps of a fit in a folder; those of another fit are removed."""

    def __init__(self, folder: Path | None, digest: str) -> None:
        self._folder = folder
        if folder is None:
            return
        mark = folder / digest
        if folder.exists() and not mark.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        mark.touch()

    def load(self, name: str) -> dict[str, Any] | None:
        path = self._folder and self._folder / f"{name}.npz"
        if path is None or not path.exists():
            return None
        with np.load(path) as file:
            return dict(file)

    def save(self, name: str, arrays: Mapping[str, Any]) -> None:
        if self._folder is not None:
            part = self._folder / f"{name}.part.npz"
            np.savez(part, **arrays)
            os.replace(part, self._folder / f"{name}.npz")

    def remove(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder)


def _digest(
    calibration: Calibration, presses: Sequence[KnownPress], stated: Mapping[str, float], effort: Effort
) -> str:
    digest = hashlib.sha256(calibration.reference_white.tobytes() + calibration.reference_grey.tobytes())
    digest.update(repr((calibration.geometry, calibration.pitch_px, sorted(stated.items()), effort)).encode())
    for press in presses:
        digest.update(press.image.tobytes() + repr((press.radius_mm, press.depth_mm, press.x_mm, press.y_mm)).encode())
    for name in (*LADDER, SHEAR):
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
    calibration: Calibration, prints: Sequence[Found], mechanics: Mechanics, seed: int, effort: Effort
) -> Frames:
    return simulate(calibration, prints, mechanics, seed, effort.skins, effort.views)


def _frames(pool: ProcessPoolExecutor, jobs: Sequence[tuple[Any, ...]], kept: _Kept, say: Say) -> list[Frames]:
    parts: dict[int, Frames] = {}
    for seed in range(len(jobs)):
        if (arrays := kept.load(f"frames-{seed}")) is not None:
            parts[seed] = _from_arrays(arrays)
    waiting = {pool.submit(_simulated, *job): seed for seed, job in enumerate(jobs) if seed not in parts}
    began_s, total = time.monotonic(), len(waiting)
    while waiting:
        for future in wait(waiting, _SAY_S, "FIRST_COMPLETED").done:
            seed = waiting.pop(future)
            parts[seed] = future.result()
            kept.save(f"frames-{seed}", _arrays(parts[seed]))
        finished = total - len(waiting)
        left = f", {(time.monotonic() - began_s) * len(waiting) / finished:.0f} s left" if finished else ""
        say(f"fit: simulated {len(parts)} of {len(jobs)} skins{left}, then training")
    return [parts[seed] for seed in range(len(jobs))]


def _arrays(frames: Frames) -> dict[str, Any]:
    plain = {field.name: getattr(frames, field.name) for field in fields(Frames)}
    ways = {f"{name}.{way}": each for name in ("reference", "white") for way, each in plain.pop(name).items()}
    return plain | ways


def _from_arrays(arrays: Mapping[str, Any]) -> Frames:
    made: dict[str, Any] = {"reference": {}, "white": {}}
    for name, each in arrays.items():
        what, _, way = name.partition(".")
        if way:
            made[what][way] = each
        else:
            made[what] = each
    return Frames(**made)


def _trained(
    pool: ProcessPoolExecutor, calibration: Calibration, parts: Sequence[Frames], names: Sequence[str],
    effort: Effort, done: Any, kept: _Kept, say: Say,
) -> dict[str, F32]:  # fmt: skip
    weights: dict[str, F32] = {}
    waiting: dict[Future[F32], str] = {}
    for number, name in enumerate(names):
        if (arrays := kept.load(name)) is not None:
            weights[name], done[number] = arrays["weights"], effort.steps
        else:
            waiting[pool.submit(_train, calibration, parts[: -effort.held_out], name, number, effort.steps)] = name
    cost = {name: _COSTS[name] for name in waiting.values()}
    began_s = said_s = time.monotonic()
    while waiting:
        for future in wait(waiting, 1.0, "FIRST_COMPLETED").done:
            name = waiting.pop(future)
            weights[name] = future.result()
            kept.save(name, {"weights": weights[name]})
        part = sum(cost[name] * done[k] for k, name in enumerate(names) if name in cost)
        part /= max(sum(cost.values()) * effort.steps, 1)
        if (now_s := time.monotonic()) - said_s >= _SAY_S and part > 0:
            said_s = now_s
            say(f"fit: training, {100 * part:.0f} % done, about {(now_s - began_s) * (1 / part - 1):.0f} s left")
    return weights


def _train(calibration: Calibration, parts: Sequence[Frames], name: str, number: int, steps: int) -> F32:
    network = TorchNetwork(name)

    def report(step: int) -> None:
        _steps_done[number] = step

    training.train(network, training.maps_of(calibration, parts, name), _skin_radii(calibration), steps, report)
    return network.flat()


def _skin_radii(calibration: Calibration) -> float:
    return math.sin(math.radians(calibration.geometry.visible_half_angle_deg))


def _judged(
    calibration: Calibration, presses: Sequence[KnownPress], parts: Sequence[Frames], name: str, weights: F32
) -> tuple[FittedNetwork, NetworkReport]:
    maps = training.maps_of(calibration, parts, name)
    unit_mm = calibration.geometry.skin_radius_mm * _skin_radii(calibration)
    shipped, network = TorchNetwork(name), TorchNetwork(name)
    network.load(weights)
    shipped_mm, fitted_mm = (unit_mm * training.error(each, maps) for each in (shipped, network))
    (fold, cells), channels = network_size(name), weights_of(network_files(name)[1])[0].shape[0]
    correction = np.zeros((channels, cells // fold, cells // fold), np.float32)
    made = FittedNetwork(shipped_layout(name), weights, correction, 0, fitted_mm, shipped_mm)
    if name == SHEAR or not presses:
        return made, NetworkReport(name, shipped_mm, fitted_mm)
    before, after = (
        on_presses(calibration, PROFILES[name], load_network(name, each), presses) for each in (None, made)
    )
    if not before.errors_mm:
        return made, NetworkReport(name, shipped_mm, fitted_mm)
    if not after.errors_mm:
        return made, NetworkReport(name, shipped_mm, fitted_mm, before.mean_mm, math.inf)
    made = FittedNetwork(
        made.layout, weights, correction, after.presses, after.mean_mm, before.mean_mm, after.error_scale
    )
    return made, NetworkReport(name, shipped_mm, fitted_mm, before.mean_mm, after.mean_mm)


def _words(prints: Sequence[Found], mechanics: Mechanics, stated: Mapping[str, float]) -> tuple[str, ...]:
    """What was found, in words that a person can check against the drawing."""
    best = prints[0]
    pitch_mm = best.base.pitch_mm
    named = zip(("pins", "tips", "bases", "markers"), ("long", *["in radius"] * 3), PARAMETERS, strict=True)
    sizes = []
    for k, (what, how, parameter) in enumerate(named):
        if best.kind.white_tips and what == "markers":
            continue
        key = parameter.replace("_pitches", "_mm")
        if key in stated:
            sizes.append(f"{what} {stated[key]:g} mm {how} as stated")
            continue
        each = pitch_mm * np.array([found.values[k] for found in prints])
        spread = pitch_mm * math.sqrt(best.cloud()[k, k])
        sizes.append(f"{what} {max(each.min() - spread, 0):.2f} to {each.max() + spread:.2f} mm {how}")
    unexplained = f"{100 * best.residual:.0f} % of the pattern unexplained"
    lines = [f"found a print of {best.kind.name}, pitch {pitch_mm:.2f} mm: {', '.join(sizes)} ({unexplained})"]
    if mechanics.seen:
        decay = " to ".join(f"{each:.1f}" for each in mechanics.decay_mm)
        friction = " to ".join(f"{each:.1f}" for each in mechanics.friction)
        lines.append(f"found that the skin's dent decays over {decay} mm beside a contact, and friction {friction}")
    return tuple(lines)


def _advice(mechanics: Mechanics) -> tuple[str, ...]:
    if mechanics.seen:
        return ()
    return (f"press at least {LEAST_PRESSES} balls at stated places: they show how soft the skin is",)
