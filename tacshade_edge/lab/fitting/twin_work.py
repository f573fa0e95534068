"""The long work of a fit, on all cores: twins are simulated, then the networks train on them.

A worker ends with the command, however that ends; what is finished is kept (`Steps`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from multiprocessing.sharedctypes import SynchronizedArray

import torch

from tacshade_edge.lab.fitting import training
from tacshade_edge.lab.fitting.judge import skin_radii
from tacshade_edge.lab.fitting.prints import Found
from tacshade_edge.lab.fitting.torch_network import TorchNetwork
from tacshade_edge.lab.fitting.twin import Frames, Mechanics, Steps, simulate
from tacshade_edge.lab.parallel import SPAWN, processes, usable_cores
from tacshade_edge.sensor.profiles import DEFAULT, LADDER
from tacshade_edge.types import F32, Calibration

_MOST_WORKERS = 4
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


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What the workers of one fit know: the sensor, its prints and mechanics, how much to do, and
    where finished steps are kept.
    """

    calibration: Calibration
    prints: Sequence[Found]
    mechanics: Mechanics
    effort: Effort
    steps: Steps

    def held_out(self) -> list[Frames]:
        """The frames that no training sees."""
        first = self.effort.batches - self.effort.held_out
        return [self.steps.frames(_frames_name(seed)) for seed in range(first, self.effort.batches)]


def worked(task: Task, say: Say) -> dict[str, F32]:
    """Simulate and train, but for what is kept; return the weights of each network.

    Raises DeviceError (the system killed a worker; a step cannot be written).
    """
    # The dearest first, so that no core is left alone with it at the end.
    names = sorted(NAMES, key=lambda name: -_COSTS[name])
    done = SPAWN.Array("i", len(names))
    most = min(usable_cores(), _MOST_WORKERS)
    with processes(most=most, prepare=_prepare, arguments=(done,)) as pool:
        seeds = [k for k in range(task.effort.batches) if not task.steps.has(_frames_name(k))]
        jobs = [pool.submit(_simulate, task, seed) for seed in seeds]
        _wait(jobs, lambda finished: finished / max(len(jobs), 1), "simulating", say)
        to_train = [name for name in names if not task.steps.has(name)]
        jobs = [pool.submit(_train, task, name, k) for k, name in enumerate(to_train)]
        cost = task.effort.steps * sum(_COSTS[name] for name in to_train)

        def trained(_: int) -> float:
            return float(sum(_COSTS[name] * done[k] for k, name in enumerate(to_train))) / cost

        _wait(jobs, trained, "training", say)
    return {name: task.steps.weights(name) for name in names}


def _frames_name(seed: int) -> str:
    return f"frames-{seed}"


_steps_done: SynchronizedArray[int] | None = None


def _prepare(done: SynchronizedArray[int]) -> None:
    """Prepare a worker: one thread, because the workers share the cores;
    `done` counts the steps of each training.
    """
    global _steps_done
    _steps_done = done
    # More threads would only wait for those of the other workers.
    torch.set_num_threads(1)


def _simulate(task: Task, seed: int) -> None:
    effort = task.effort
    frames = simulate(
        task.calibration, task.prints, task.mechanics, seed, effort.skins, effort.views
    )
    task.steps.save_frames(_frames_name(seed), frames)


def _train(task: Task, name: str, number: int) -> None:
    network, effort = TorchNetwork(name), task.effort
    # The last batches are held out, whichever network is trained.
    seeds = range(effort.batches - effort.held_out)
    parts = [task.steps.frames(_frames_name(seed)) for seed in seeds]
    maps = training.maps_of(task.calibration, parts, name)
    # Half of the memory of a training.
    del parts
    done = _steps_done
    assert done is not None

    def report(step: int) -> None:
        done[number] = step

    training.train(network, maps, skin_radii(task.calibration), effort.steps, report)
    task.steps.save_weights(name, network.flat())


def _wait(
    jobs: Sequence[Future[None]], part_of: Callable[[int], float], what: str, say: Say
) -> None:
    """Wait for jobs, and say every few seconds which is done; raise what one of them raised."""
    began_s, slow = time.monotonic(), False
    waiting = set(jobs)
    while waiting:
        # FIRST_EXCEPTION: what one of them raised must not wait for the others.
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
