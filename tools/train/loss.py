"""What is trained for, and how far it is from it."""

from __future__ import annotations

import numpy as np
import torch
from data import Data, batch
from network import HEIGHT_SCALE, SHEAR_CELLS, Net
from torch import Tensor
from torch.nn import functional
from torn import spoil

FOREIGN_WEIGHT = 0.5
FOREIGN_CELLS = 0.05
"""A frame with so many foreign cells counts as torn in the figures."""
DISC_MM = 15.0
"""A typical disc radius, to print figures in mm."""


def split_output(y: Tensor, fold: int) -> tuple[Tensor, Tensor]:
    """Height and contact logits (B, cells, cells)."""
    y = functional.pixel_shuffle(y.float(), fold)
    return y[:, 0], y[:, 1]


def loss_of(
    outputs: tuple[Tensor, Tensor, Tensor], fold: int, height: Tensor, contact: Tensor, shear: Tensor, foreign: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Of height and its slope and the contact's outline; of displacement; of what is foreign. Heavier in contact."""
    y, moved, odds = outputs
    found, logit = split_output(y, fold)
    top = height.amax((1, 2), keepdim=True)
    weight = (0.5 + 5 * contact) * (1.5 / (top + 0.7))
    off = found - height
    level = (weight * off.abs()).mean()
    slope = (weight[:, 1:] * (off[:, 1:] - off[:, :-1]).abs()).mean()
    slope = slope + (weight[:, :, 1:] * (off[:, :, 1:] - off[:, :, :-1]).abs()).mean()
    edge = functional.binary_cross_entropy_with_logits(logit, contact)
    p = torch.sigmoid(logit)
    dice = 1 - (2 * (p * contact).sum((1, 2)) + 20) / ((p + contact).sum((1, 2)) + 20)
    touching = functional.adaptive_avg_pool2d(contact[:, None], SHEAR_CELLS)
    seen = functional.adaptive_avg_pool2d(1 - foreign[:, None], SHEAR_CELLS)
    off = (moved.float() - shear).abs().sum(1, keepdim=True) * (seen > 0.99)
    strange = functional.binary_cross_entropy_with_logits(odds.float(), 1 - seen)
    return level + 1.5 * slope + edge + 0.15 * dice.mean(), ((0.3 + 4 * touching) * off).mean(), strange


def figures(net: Net, data: Data) -> dict[str, float]:
    """Errors on sensors that were not trained on, as if their disc's radius were 15 mm."""
    net.eval()
    errors, relative, ious, shapes, shears = [], [], [], [], []
    strange, torn, rng = [], [], np.random.default_rng(0)
    with torch.no_grad():
        for start in range(0, len(data.frame), 32):
            x, height, contact, shear = batch(data, np.arange(start, min(start + 32, len(data.frame))))
            white, at_rest = functional.pixel_shuffle(x[:, : 2 * data.fold**2], data.fold).unbind(1)
            white = white.contiguous()
            spoil(white, at_rest, height.clone(), contact.clone(), 1.0, rng)
            spoiled = torch.cat((functional.pixel_unshuffle(white[:, None], data.fold), x[:, data.fold**2 :]), 1)
            with torch.autocast("cpu", torch.bfloat16):
                torn += list((net(spoiled)[2].float() > 0).float().mean((1, 2, 3)))
                y, moved, odds = net(x)
            strange += list((odds.float() > 0).float().mean((1, 2, 3)))
            found, logit = split_output(y, data.fold)
            touching = functional.adaptive_avg_pool2d(contact[:, None], SHEAR_CELLS)
            means = [
                (touching * each.float()).sum((2, 3)) / touching.sum((2, 3)).clamp(min=1e-3) for each in (moved, shear)
            ]
            moved_off = torch.linalg.vector_norm(means[0] - means[1], dim=1) * (DISC_MM / HEIGHT_SCALE)
            for f, h, p, c, m in zip(found, height, logit > 0, contact > 0, moved_off, strict=True):
                if c.sum() < 20:
                    continue
                shears.append(float(m))
                off = (f - h)[c] * (DISC_MM / HEIGHT_SCALE)
                errors.append(float(off.abs().mean()))
                shapes.append(float((off - off.median()).abs().mean()))
                relative.append(float(abs(f.max() / h.max() - 1)))
                ious.append(float((p & c).sum() / (p | c).sum()))
    net.train()
    names = ("error_mm", "shape_error_mm", "depth_error", "iou", "shear_error_mm")
    values = (errors, shapes, relative, ious, shears)
    row = {n: round(float(np.mean(v)), 4) for n, v in zip(names, values, strict=True)}
    return row | {"called_torn": share_over(strange, FOREIGN_CELLS), "torn": share_over(torn, FOREIGN_CELLS)}


def share_over(values: list[Tensor], limit: float) -> float:
    """The part of values over a limit."""
    return round(float(np.mean(np.array(values) > limit)), 4)
