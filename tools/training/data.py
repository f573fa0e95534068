"""Load the shards of make_data.py and cut them into batches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tools.training.network import COARSE_CELLS, DISC_MM, HEIGHT_SCALE

KINDS = ("plain", "uneven", "wide", "varied", "other", "outside")
"""Kinds of sensors, in shards from 0, 5000, 10000, 15000, 20000 and 25000 on."""


@dataclass(slots=True, eq=False)
class Data:
    """All samples, in memory as stored; `sensor` gives each frame's row in `reference` and `known`."""

    reference: np.ndarray
    known: np.ndarray
    frame: np.ndarray
    height: np.ndarray
    contact: np.ndarray
    shear: np.ndarray
    sensor: np.ndarray
    fold: int

    def chances(self) -> np.ndarray:
        """Weight each frame for drawing: presses like those of users come more often than extreme ones."""
        return np.where(self._usual(), 2.5, 1.0) * np.where(self._pressed_only(), 2.0, 1.0)

    def _usual(self) -> np.ndarray:
        """Whether a frame is at most 4.8 mm deep and dragged by 3.2 mm, on a skin with a radius of 20 mm."""
        return (self._depth_max_mm() < 4.8) & (self._drag_mm() < 3.2)

    def _pressed_only(self) -> np.ndarray:
        return (self._depth_max_mm() > 0) & (self._drag_mm() < 0.15)

    def _depth_max_mm(self) -> np.ndarray:
        return self.height.reshape(len(self.height), -1).max(axis=1).astype(np.float32) * DISC_MM

    def _drag_mm(self) -> np.ndarray:
        """How far the skin in contact has moved sideways, on average."""
        drag_mm = np.zeros(len(self.frame), np.float32)
        for k, (packed, shear) in enumerate(zip(self.contact, self.shear, strict=True)):
            cells, coarse = np.unpackbits(packed, axis=-1), len(shear)
            by = len(cells) // coarse
            part = cells.reshape(coarse, by, coarse, by).mean(axis=(1, 3))
            if part.any():
                drag_mm[k] = np.linalg.norm(np.einsum("ij,ijk->k", part, shear)) / part.sum() * DISC_MM
        return drag_mm


def shards_in(folder: Path) -> dict[str, list[Path]]:
    """Find the shards in a folder, sorted by kind."""
    shards: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("shard_*.npz")):
        shards.setdefault(KINDS[int(path.stem[6:]) // 5000], []).append(path)
    return shards


def load(paths: list[Path], fold: int, cells: int) -> Data:
    """Read shards, whose maps have 112x112 cells."""
    parts: dict[str, list[np.ndarray]] = {k: [] for k in ("reference", "known", "frame", "height", "contact", "shear")}
    for path in paths:
        with np.load(path) as shard:
            for name, values in parts.items():
                array = pooled(name, shard[name], 112 // cells)
                values.append(array[..., ::fold, ::fold] if name == "known" else array)
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    sensors, frames = joined["frame"].shape[:2]
    for name in ("frame", "height", "contact", "shear"):
        joined[name] = joined[name].reshape(sensors * frames, *joined[name].shape[2:])
    return Data(**joined, sensor=np.repeat(np.arange(sensors), frames), fold=fold)


def pooled(name: str, array: np.ndarray, by: int) -> np.ndarray:
    """Average `by` x `by` cells; a pooled cell is in contact where half of them touch."""
    if name == "shear":  # stored on 56x56 cells
        *first, rows, cols, two = array.shape
        by = rows // COARSE_CELLS
        return array.reshape(*first, rows // by, by, cols // by, by, two).mean(axis=(-4, -2), dtype=np.float32)
    if by == 1:
        return array
    values = np.unpackbits(array, axis=-1) if name == "contact" else array
    *first, rows, cols = values.shape
    means = values.reshape(*first, rows // by, by, cols // by, by).mean(axis=(-3, -1), dtype=np.float32)
    if name == "contact":
        return np.packbits(means >= 0.5, axis=-1)
    return (np.rint(means) if array.dtype == np.uint8 else means).astype(array.dtype)


def batch(data: Data, index: np.ndarray, turn: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Make a network's inputs; 10 h and contact (B, cells, cells); 10 times the shear (B, 2, coarse, coarse cells).

    `turn` selects one of the square's 8 symmetries.
    """

    def turned(array: np.ndarray) -> np.ndarray:
        array = np.rot90(array, turn % 4, axes=(1, 2))
        return np.ascontiguousarray(array[:, :, ::-1] if turn >= 4 else array)

    sensor = data.sensor[index]
    maps = np.stack((turned(data.frame[index]), turned(data.reference[sensor])), axis=1)
    maps = torch.from_numpy(maps).float() / 255
    # A turned sensor is another sensor of the family, so the maps of its geometry are not turned.
    known = torch.from_numpy(data.known[sensor].astype(np.float32))
    x = torch.cat((functional.pixel_unshuffle(maps, data.fold), known), 1)
    height = torch.from_numpy(turned(data.height[index]).astype(np.float32) * HEIGHT_SCALE)
    contact = np.unpackbits(data.contact[index], axis=-1)
    x_y = turned(data.shear[index].astype(np.float32) * HEIGHT_SCALE)
    for _ in range(turn % 4):  # a quarter turn of rows and columns maps x to -y and y to x
        x_y = np.stack((x_y[..., 1], -x_y[..., 0]), axis=-1)
    if turn >= 4:
        x_y = x_y * np.array((-1, 1), np.float32)
    shear = torch.from_numpy(np.ascontiguousarray(np.moveaxis(x_y, 3, 1)))
    return x.contiguous(memory_format=torch.channels_last), height, torch.from_numpy(turned(contact)).float(), shear
