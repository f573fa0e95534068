"""What a training minimises: losses of depth, contact, untrusted cells and shear."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional

COARSE_CELLS = 28
"""Cells along a side of the maps of shear and of untrusted cells."""
UNTRUSTED_WEIGHT = 0.5


def split_output(y: Tensor, fold: int) -> tuple[Tensor, Tensor]:
    """Split a network's output into height and contact logits (B, cells, cells)."""
    y = functional.pixel_shuffle(y.float(), fold)
    return y[:, 0], y[:, 1]


def depth_loss(
    outputs: tuple[Tensor, Tensor],
    fold: int,
    height: Tensor,
    contact: Tensor,
    shear: Tensor,
    untrusted: Tensor,
) -> Tensor:
    """Sum the losses of height and its slope (weighted higher in contact), of contact,
    and of untrusted cells.
    """
    y, odds = outputs
    found, logit = split_output(y, fold)
    top = height.amax((1, 2), keepdim=True)
    # A shallow contact would hardly count beside a deep one; so each is weighed by its own depth.
    weight = (0.5 + 5 * contact) * (1.5 / (top + 0.7))
    off = found - height
    level = (weight * off.abs()).mean()
    # Slopes, too: an edge at the wrong place is worse than a level that is a little off.
    slope = (weight[:, 1:] * (off[:, 1:] - off[:, :-1]).abs()).mean()
    slope = slope + (weight[:, :, 1:] * (off[:, :, 1:] - off[:, :, :-1]).abs()).mean()
    edge = functional.binary_cross_entropy_with_logits(logit, contact)
    p = torch.sigmoid(logit)
    # The 20 keep a contact of a few cells from deciding over the loss of a batch.
    dice = 1 - (2 * (p * contact).sum((1, 2)) + 20) / ((p + contact).sum((1, 2)) + 20)
    seen = functional.adaptive_avg_pool2d(1 - untrusted[:, None], COARSE_CELLS)
    strange = functional.binary_cross_entropy_with_logits(odds.float(), 1 - seen)
    return level + 1.5 * slope + edge + 0.15 * dice.mean() + UNTRUSTED_WEIGHT * strange


def shear_loss(
    moved: Tensor, fold: int, height: Tensor, contact: Tensor, shear: Tensor, untrusted: Tensor
) -> Tensor:
    """Compute the loss of shear where the skin is visible, weighted higher in contact."""
    touching = functional.adaptive_avg_pool2d(contact[:, None], COARSE_CELLS)
    seen = functional.adaptive_avg_pool2d(1 - untrusted[:, None], COARSE_CELLS)
    # Only where nothing is spoilt: no shear is known there.
    off = (moved.float() - shear).abs().sum(1, keepdim=True) * (seen > 0.99)
    return ((0.3 + 4 * touching) * off).mean()


LOSSES: dict[str, Callable[..., Tensor]] = {"depth": depth_loss, "shear": shear_loss}
"""The loss of each of `network.NETS`, from its output, its fold and the true maps."""
