"""The figures that measure a network's errors while it is trained."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from tacshade_edge.lab.fitting.losses import split_output
from tacshade_edge.lab.fitting.spoilt_frames import spoil
from tacshade_edge.lab.fitting.training import halved
from tools.training.data import Data, batch
from tools.training.network import COARSE_CELLS, DISC_MM, HEIGHT_SCALE

UNTRUSTED_CELLS = 0.05
"""A frame with more than this share of untrusted cells counts as torn in the figures."""
LEAST_CELLS, STILL_MM = 60, 0.1
"""Contacts with fewer cells (of 112x112) are not scored;
contacts that moved by less count as undragged.
"""


def depth_figures(net: nn.Module, data: Data) -> dict[str, float]:
    """Measure the errors on sensors that were not trained on,
    as if their disc's radius were 15 mm.
    """
    errors, relative, ious, shapes, still = [], [], [], [], []
    strange, torn, rng = [], [], np.random.default_rng(0)
    for x, height, contact, shear in _batches(data):
        white, at_rest = functional.pixel_shuffle(x[:, : 2 * data.fold**2], data.fold).unbind(1)
        white = white.contiguous()
        spoil(white, at_rest, height.clone(), contact.clone(), 1.0, rng)
        spoiled = torch.cat(
            (functional.pixel_unshuffle(white[:, None], data.fold), x[:, data.fold**2 :]), 1
        )
        with halved(x.device.type):
            torn += list((net(spoiled)[1].float() > 0).float().mean((1, 2, 3)))
            y, odds = net(x)
        strange += list((odds.float() > 0).float().mean((1, 2, 3)))
        found, logit = split_output(y, data.fold)
        dragged = (shear * touching_part(contact)).sum((2, 3)).norm(dim=1) / touching_part(
            contact
        ).sum((1, 2, 3))
        for f, h, p, c, d in zip(found, height, logit > 0, contact > 0, dragged, strict=True):
            if c.sum() < LEAST_CELLS * (c.shape[-1] / 112) ** 2:
                continue
            off = (f - h)[c] * (DISC_MM / HEIGHT_SCALE)
            errors.append(float(off.abs().mean()))
            shapes.append(float((off - off.median()).abs().mean()))
            relative.append(float(abs(f.max() / h.max() - 1)))
            ious.append(float((p & c).sum() / (p | c).sum()))
            if d * (DISC_MM / HEIGHT_SCALE) < STILL_MM:
                still.append(errors[-1])
    names = ("error_mm", "undragged_error_mm", "shape_error_mm", "depth_error", "iou")
    values = (errors, still, shapes, relative, ious)
    row = {n: round(float(np.mean(v)), 4) for n, v in zip(names, values, strict=True)}
    return row | {
        "called_torn": share_over(strange, UNTRUSTED_CELLS),
        "torn": share_over(torn, UNTRUSTED_CELLS),
    }


def shear_figures(net: nn.Module, data: Data) -> dict[str, float]:
    """Measure the error of contacts' shear, as if the disc's radius were 15 mm."""
    off, size = [], []
    for x, _, contact, shear in _batches(data):
        with halved(x.device.type):
            moved = net(x).float()
        touching = touching_part(contact)
        found, true = (
            (touching * each).sum((2, 3)) / touching.sum((2, 3)).clamp(min=1e-3)
            for each in (moved, shear)
        )
        there = contact.sum((1, 2)) >= LEAST_CELLS
        off += ((found - true).norm(dim=1)[there] * (DISC_MM / HEIGHT_SCALE)).tolist()
        size += (true.norm(dim=1)[there] * (DISC_MM / HEIGHT_SCALE)).tolist()
    dragged = np.array(off)[np.array(size) > STILL_MM]
    values = {
        "shear_error_mm": np.mean(off),
        "median_mm": np.median(off),
        "dragged_median_mm": np.median(dragged),
    }
    return {name: round(float(value), 4) for name, value in values.items()}


FIGURES: dict[str, Callable[[nn.Module, Data], dict[str, float]]] = {
    "depth": depth_figures,
    "shear": shear_figures,
}


@torch.no_grad()
def _batches(data: Data) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
    for start in range(0, len(data.frame), 32):
        yield batch(data, np.arange(start, min(start + 32, len(data.frame))))


def touching_part(contact: Tensor) -> Tensor:
    """The share of each coarse cell that is in contact, (B, 1, COARSE_CELLS, COARSE_CELLS)."""
    return functional.adaptive_avg_pool2d(contact[:, None], COARSE_CELLS)


def share_over(values: list[Tensor], limit: float) -> float:
    """The share of values above a limit."""
    return round(float((torch.stack(values) > limit).float().mean()), 4)
