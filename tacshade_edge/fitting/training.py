"""Trains a network further with presses, and rehearses what it knows of other sensors: the losses and the steps."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tacshade_edge.core.calibration.refit.press_targets import VIEWS, PressTarget, Targets
from tacshade_edge.fitting.rehearsal import Rehearsal
from tacshade_edge.fitting.torch_network import TorchNetwork

STEPS, BATCH = 300, 12
RATE = 3e-3
"""Greatest learning rate of a one-cycle schedule (Smith and Topin, 2019) for Adam."""
OWN_PART = 0.3
"""Share of the steps that always see the sensor as it is; the others draw one of `VIEWS`."""
REHEARSAL_WEIGHT, REHEARSED_AT_ONCE = 1.0, 48
OUTLINE_WEIGHT, FAR_WEIGHT, UNTRUSTED_WEIGHT = 2.0, 1.0, 0.5
MORE_CELLS = 20
"""Added to the cell count that divides a press's loss, so that a small press weighs less than a wide one."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Presses as tensors; see `PressTarget`."""

    white: Tensor
    surface: Tensor
    known: Tensor
    above: Tensor
    far: Tensor
    inside: Tensor
    height: Tensor
    contact: Tensor
    untrusted: Tensor

    @classmethod
    def of(cls, presses: Sequence[PressTarget]) -> Batch:
        """Stack presses."""

        def stacked(name: str) -> Tensor:
            return torch.from_numpy(np.stack([getattr(press, name) for press in presses])).float()

        surface, known = stacked("surface"), stacked("known")
        # More than a cell beyond where the indenter lies inside the undeformed skin, nothing can touch.
        touchable = functional.max_pool2d((surface > 0).float(), 3, 1, 1)
        return cls(
            stacked("white"),
            surface,
            known,
            (surface > 0).float() - known,
            stacked("far"),
            stacked("inside"),
            stacked("height"),
            stacked("contact_logit").sigmoid() * touchable,
            stacked("untrusted_logit").sigmoid()[:, None],
        )

    def some(self, which: Tensor) -> Batch:
        """The presses with the given numbers."""
        return Batch(*(getattr(self, name)[which] for name in self.__slots__))

    def seen_as(self, view: int, fold: int) -> Batch:
        """The batch as another of `VIEWS` shows it."""
        turns, mirrored = VIEWS[view]

        def seen(x: Tensor) -> Tensor:
            turned = torch.rot90(x, turns, (-2, -1))
            return turned.flip(-1) if mirrored else turned

        white = functional.pixel_unshuffle(seen(functional.pixel_shuffle(self.white, fold)), fold)
        return Batch(white, *(seen(getattr(self, name)) for name in self.__slots__[1:]))


def loss(network: TorchNetwork, fold: int, batch: Batch, factor: float, view: int = 0) -> Tensor:
    """Loss of a network on presses; `factor` is the one on the shipped network's heights."""
    folded, untrusted = network(batch.white, network.sensors[view])
    height, logit = functional.pixel_shuffle(folded, fold).unbind(1)
    level = _per_press((height - batch.surface).abs(), batch.known)
    # Where the skin has lifted off the indenter, it lies deeper than the indenter's surface.
    lifted = _per_press(functional.relu(batch.surface - height), batch.above)
    far = _per_press((height - factor * batch.height).abs(), batch.far)
    outline = functional.binary_cross_entropy_with_logits(logit, batch.contact, reduction="none")
    strange = functional.binary_cross_entropy_with_logits(untrusted, batch.untrusted)
    return (
        level
        + lifted
        + FAR_WEIGHT * far
        + OUTLINE_WEIGHT * _per_press(outline, batch.inside)
        + UNTRUSTED_WEIGHT * strange
    )


def _per_press(values: Tensor, weight: Tensor) -> Tensor:
    return ((values * weight).sum((1, 2)) / (weight.sum((1, 2)) + MORE_CELLS)).mean()


class Known:
    """What a network says of the frames to rehearse, before its training."""

    def __init__(self, network: TorchNetwork, fold: int, frames: Rehearsal) -> None:
        self._network, self._fold, self._frames = network, fold, frames
        with torch.no_grad():
            parts = [self._run(some) for some in torch.arange(len(frames)).split(REHEARSED_AT_ONCE)]
        self._maps, self._untrusted = (torch.cat(part) for part in zip(*parts, strict=True))

    def loss(self, which: Tensor) -> Tensor:
        """The loss of frames with the given numbers: how much their results have changed."""
        maps, untrusted = self._run(which)
        height, logit = maps.unbind(1)
        was_height, was = self._maps[which].unbind(1)
        off, touched = (height - was_height).abs(), (was > 0).float()
        outline = functional.binary_cross_entropy_with_logits(logit, was.sigmoid(), reduction="none")
        strange = functional.binary_cross_entropy_with_logits(untrusted, self._untrusted[which].sigmoid())
        return (
            _per_press(off, touched)
            + FAR_WEIGHT * _per_press(off, 1 - touched)
            + OUTLINE_WEIGHT * _per_press(outline, torch.ones_like(outline))
            + UNTRUSTED_WEIGHT * strange
        )

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._frames)

    def _run(self, which: Tensor) -> tuple[Tensor, Tensor]:
        frames = self._frames
        folded, untrusted = self._network(frames.white[which], frames.sensors[frames.sensor[which]])
        return functional.pixel_shuffle(folded, self._fold), untrusted


class Training:
    """A network in training.

    Parameters
    ----------
    network : TorchNetwork
    fold : int
    factor : float
        Multiplies the shipped network's heights.
    train : Targets
        At least one press.
    frames : Rehearsal
    """

    def __init__(self, network: TorchNetwork, fold: int, factor: float, train: Targets, frames: Rehearsal) -> None:
        self._network, self._fold, self._factor = network, fold, factor
        self._train, self._known = Batch.of(train.presses), Known(network, fold, frames)
        self._count = len(train.presses)
        self._optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
        self._schedule = torch.optim.lr_scheduler.OneCycleLR(self._optimizer, RATE, total_steps=STEPS)
        self._draw = torch.Generator().manual_seed(0)
        self.step_s = self._step_s()

    def steps(self) -> Iterator[int]:
        """Train, and yield the number of steps done after each."""
        for step in range(1, STEPS + 1):
            self._step()
            yield step

    def _step(self) -> None:
        which = torch.randperm(self._count, generator=self._draw)[:BATCH]
        self._optimizer.zero_grad(set_to_none=True)
        own = float(torch.rand((), generator=self._draw)) < OWN_PART
        view = 0 if own else int(torch.randint(len(VIEWS), (), generator=self._draw))
        self._loss(which, view).backward()
        self._optimizer.step()
        self._schedule.step()

    def _loss(self, which: Tensor, view: int) -> Tensor:
        """Loss of presses with the given numbers and of as many drawn frames."""
        batch = self._train.some(which).seen_as(view, self._fold)
        rehearsed = torch.randint(len(self._known), (BATCH,), generator=self._draw)
        own = loss(self._network, self._fold, batch, self._factor, view)
        return own + REHEARSAL_WEIGHT * self._known.loss(rehearsed)

    def _step_s(self) -> float:
        """Duration of a training step, s; measuring it changes no weight."""
        which = torch.arange(min(BATCH, self._count))
        taken = []
        for _ in range(3):
            began_s = time.monotonic()
            self._loss(which, 0).backward()
            taken.append(time.monotonic() - began_s)
        self._optimizer.zero_grad(set_to_none=True)
        return min(taken)
