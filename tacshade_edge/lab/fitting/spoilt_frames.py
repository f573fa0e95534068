"""Frames of a twin that the camera spoils: rows that tear, repeat or are another sensor's,
a camera that moved.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from tacshade_edge.sensor.geometry import disc_map

MOVED_CELLS = (0.6, 14.0)
"""How far the picture moves if the camera moved, as in about a fifth of the spoilt frames."""


def spoil(
    maps: Tensor,
    references: Tensor,
    height: Tensor,
    contact: Tensor,
    part: float,
    rng: np.random.Generator,
) -> Tensor:
    """Spoil part of a batch in place; cells that no longer show the skin lose their depth
    and contact.

    `maps`, `references`, `height`, `contact`: white of the frames and of their sensors at rest, and
    the frames' true height and contact. `part`: share of the frames to spoil. Returns (Tensor (B,
    cells, cells)): 1 where a cell does not show the sensor's skin.
    """
    cells, device = maps.shape[-1], maps.device
    axis = (torch.arange(cells, device=device) + 0.5 - cells / 2) * (2 * disc_map.REACH / cells)
    inside = ((axis[:, None] ** 2 + axis[None, :] ** 2) <= 1).float()
    untrusted = torch.zeros_like(maps)
    frames = np.flatnonzero(rng.random(len(maps)) < part)
    if not len(frames):
        return untrusted
    drawn = [_draw(int(k), len(maps), cells, rng) for k in frames]
    source, rows, cols, torn = (
        torch.from_numpy(np.stack(each)).to(device) for each in zip(*drawn, strict=True)
    )
    index, torn = torch.from_numpy(frames).to(device), torn[:, :, None]
    spoiled = _moved(torch.cat((maps, references))[source], rows, cols)
    maps[index] = torch.where(torn, spoiled, maps[index]) * inside
    untrusted[index] = torn * inside
    # What is spoilt has no depth: networks learn to claim none there.
    height *= 1 - untrusted
    contact *= 1 - untrusted
    return untrusted


def _draw(k: int, frames: int, cells: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Draw what frame `k` shows: the picture (a frame, or from `frames` on a reference),
    its rows and columns.

    The last array holds which of the frame's rows show it.
    """
    row, size = (
        max(int(rng.integers(-cells // 4, int(0.85 * cells))), 0),
        int(rng.integers(3, cells // 2)),
    )
    # Each kind is a way in which pictures go wrong: rows are lost, repeated or of another frame, or
    # the camera has moved.
    source, kind = k, int(rng.integers(5))
    end = cells if rng.random() < 0.7 else min(cells, row + int(rng.integers(6, cells)))
    rows, cols = np.arange(cells, dtype=np.float32), np.arange(cells, dtype=np.float32)
    if kind == 0:  # the remaining rows move sideways
        cols = np.roll(cols, size * int(rng.choice((-1, 1))))
    elif kind == 1:  # one row repeats
        rows = np.full_like(rows, row)
    elif kind == 2:  # the remaining rows move down
        rows = np.roll(rows, size)
    elif kind == 3:  # the remaining rows come from another sensor
        source = int(rng.integers(frames))
    else:  # the camera moved against its housing; copies of the outermost cells fill the gap
        far, angle = math.exp(rng.uniform(*np.log(MOVED_CELLS))), rng.uniform(0, 2 * math.pi)
        # Of a frame or of the reference: a camera may have moved in its housing before the first
        # touch.
        source = k if rng.random() < 0.5 else frames + k
        row, end = 0, cells
        rows, cols = (
            rows - np.float32(far * math.cos(angle)),
            cols - np.float32(far * math.sin(angle)),
        )
    number = np.arange(cells)
    return (
        np.array(source),
        rows.clip(0, cells - 1),
        cols.clip(0, cells - 1),
        (number >= row) & (number < end),
    )


def _moved(pictures: Tensor, rows: Tensor, cols: Tensor) -> Tensor:
    """Take other rows and columns of pictures (P, cells, cells), whose numbers (P,
    cells) may be fractions.
    """
    for number, dim in ((rows, 1), (cols, 2)):
        low = number.floor()
        part = (number - low).unsqueeze(3 - dim)
        first, second = (
            pictures.gather(
                dim,
                each.long()
                .clamp(max=pictures.shape[dim] - 1)
                .unsqueeze(3 - dim)
                .expand_as(pictures),
            )
            for each in (low, low + 1)
        )
        pictures = first + (second - first) * part
    return pictures
