"""Spoil maps as real frames can be: torn, from another sensor, or from a moved camera."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tacshade_edge.core.geometry import disc_map

MOVED_CELLS = (0.6, 14.0)
"""How far the picture moves if the camera moved, as in about a fifth of the spoilt frames."""


def moved(picture: Tensor, down: float, right: float) -> Tensor:
    """Move the picture of a map (N, N) by so many cells; copies of its outermost cells fill the gap."""
    cells = picture.shape[-1]
    rows, cols = ((torch.arange(cells) - by).clamp(0, cells - 1) for by in (down, right))
    grid = torch.stack(torch.meshgrid(rows, cols, indexing="ij")[::-1], -1) * (2 / (cells - 1)) - 1
    return functional.grid_sample(picture[None, None], grid[None], align_corners=True)[0, 0]


def spoil(
    maps: Tensor, references: Tensor, height: Tensor, contact: Tensor, part: float, rng: np.random.Generator
) -> Tensor:
    """Spoil part of a batch in place; cells that no longer show the skin lose their depth and contact.

    Parameters
    ----------
    maps, references, height, contact : Tensor (B, cells, cells)
        White of the frames and of their sensors at rest, and the frames' true height and contact.
    part : float
        Share of the frames to spoil.
    rng : numpy.random.Generator

    Returns
    -------
    Tensor (B, cells, cells)
        1 where a cell does not show the sensor's skin.
    """
    cells = maps.shape[-1]
    axis = (torch.arange(cells) + 0.5 - cells / 2) * (2 * disc_map.REACH / cells)
    inside = (axis[:, None] ** 2 + axis[None, :] ** 2) <= 1
    untrusted = torch.zeros_like(maps)
    others = maps.clone()
    for k in np.flatnonzero(rng.random(len(maps)) < part):
        row, size = int(rng.integers(-cells // 4, 0.85 * cells)), int(rng.integers(3, cells // 2))
        row, kind = max(row, 0), int(rng.integers(5))
        end = cells if rng.random() < 0.7 else min(cells, row + int(rng.integers(6, cells)))
        frame, spoiled = maps[k], maps[k].clone()
        if kind == 0:  # the remaining rows move sideways
            spoiled[row:end] = torch.roll(frame[row:end], size * int(rng.choice((-1, 1))), 1)
        elif kind == 1:  # one row repeats
            spoiled[row:end] = frame[row]
        elif kind == 2:  # the remaining rows move down
            spoiled[row:end] = torch.roll(frame, size, 0)[row:end]
        elif kind == 3:  # the remaining rows come from another sensor
            spoiled[row:end] = others[int(rng.integers(len(maps)))][row:end]
        else:  # the camera moved against its housing
            far, angle = math.exp(rng.uniform(*np.log(MOVED_CELLS))), rng.uniform(0, 2 * math.pi)
            row, end = 0, cells
            spoiled = moved(
                frame if rng.random() < 0.5 else references[k], far * math.cos(angle), far * math.sin(angle)
            )
        spoiled *= inside
        maps[k] = spoiled
        untrusted[k, row:end] = 1
        untrusted[k] *= inside
        height[k] *= 1 - untrusted[k]
        contact[k] *= 1 - untrusted[k]
    return untrusted
