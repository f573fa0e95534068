"""Load the shards of make_data.py and cut them into batches, on the processor or a GPU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tools.training.network import COARSE_CELLS, DISC_MM, HEIGHT_SCALE
from tools.training.samples import kind_of


@dataclass(slots=True, eq=False)
class Data:
    """Samples of one kind of sensors: S sensors, F frames; `sensor` (F,) gives each frame's row.

    uint8: `reference` (S, cells, cells), `frame` and `contact` (F, cells, cells); float16: `known`
    (S, 6, cells / fold, cells / fold), `height` (F, cells, cells), `shear` (F, COARSE_CELLS,
    COARSE_CELLS, 2).
    """

    reference: Tensor
    known: Tensor
    frame: Tensor
    height: Tensor
    contact: Tensor
    shear: Tensor
    sensor: Tensor
    fold: int

    def chances(self) -> Tensor:
        """Weight each frame for drawing: presses like those of users come more often
        than extreme ones.
        """
        depth_mm, drag_mm = self.height.amax((1, 2)).float() * DISC_MM, self._drag_mm()
        # Users press up to 4.8 mm deep and drag by up to 3.2 mm, on a skin with a radius of 20 mm.
        usual = (depth_mm < 4.8) & (drag_mm < 3.2)
        pressed_only = (depth_mm > 0) & (drag_mm < 0.15)
        return (1 + 1.5 * usual) * (1 + 1.0 * pressed_only)

    def _drag_mm(self) -> Tensor:
        """How far the skin in contact has moved sideways, on average."""
        parts = []
        for some in range(0, len(self.frame), 1024):
            contact, shear = (
                self.contact[some : some + 1024],
                self.shear[some : some + 1024].float(),
            )
            part = functional.adaptive_avg_pool2d(contact[:, None].float(), COARSE_CELLS)[
                :, 0, :, :, None
            ]
            parts.append(
                (part * shear).sum((1, 2)).norm(dim=1) / part.sum((1, 2, 3)).clamp(min=1e-6)
            )
        return torch.cat(parts) * DISC_MM


def joined(parts: Sequence[Data]) -> Data:
    """Join samples; sensors are numbered on."""
    first = np.cumsum([0] + [len(part.reference) for part in parts])
    sensor = torch.cat([part.sensor + int(k) for part, k in zip(parts, first, strict=False)])
    named = {
        f.name: [getattr(part, f.name) for part in parts]
        for f in fields(Data)
        if f.name not in ("sensor", "fold")
    }
    return Data(
        **{name: torch.cat(tensors) for name, tensors in named.items()},
        sensor=sensor,
        fold=parts[0].fold,
    )


def shards_in(folder: Path) -> dict[str, list[Path]]:
    """Find the shards in a folder, sorted by kind."""
    shards: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("shard_*.npz")):
        shards.setdefault(kind_of(int(path.stem[6:])), []).append(path)
    return shards


def load(paths: Sequence[Path], fold: int, cells: int, device: str = "cpu") -> Data:
    """Read shards, whose maps have 112x112 cells."""
    return joined([_shard(path, fold, cells, device) for path in paths])


def _shard(path: Path, fold: int, cells: int, device: str) -> Data:
    with np.load(path) as shard:
        arrays = {
            name: shard[name]
            for name in ("reference", "known", "frame", "height", "contact", "shear")
        }
    arrays["contact"] = np.unpackbits(arrays["contact"], axis=-1)
    sensors, frames = arrays["frame"].shape[:2]
    by, to = 112 // cells, arrays["shear"].shape[2] // COARSE_CELLS
    maps = {name: _pooled(name, array, by) for name, array in arrays.items() if name != "shear"}
    for name in ("frame", "height", "contact"):
        maps[name] = maps[name].flatten(0, 1)
    shear = torch.from_numpy(arrays["shear"]).to(torch.float32).flatten(0, 1).unflatten(2, (-1, to))
    shear = shear.unflatten(1, (-1, to)).mean((2, 4)).half()
    return Data(
        reference=maps["reference"].to(device),
        known=maps["known"][..., ::fold, ::fold].contiguous().to(device),
        frame=maps["frame"].to(device),
        height=maps["height"].to(device),
        contact=maps["contact"].to(device),
        shear=shear.to(device),
        sensor=torch.arange(sensors, device=device).repeat_interleave(frames),
        fold=fold,
    )


def _pooled(name: str, array: np.ndarray, by: int) -> Tensor:
    """Average `by` x `by` cells; a pooled cell is in contact where half of them touch."""
    values = torch.from_numpy(array)
    if by == 1:
        return values
    means = functional.avg_pool2d(values.flatten(0, -3)[:, None].float(), by)[:, 0].unflatten(
        0, values.shape[:-2]
    )
    if name == "contact":
        means = (means >= 0.5).float()
    return (means.round() if array.dtype == np.uint8 else means).to(values.dtype)


def batch(
    data: Data, index: Tensor | np.ndarray, turn: int = 0
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Make a network's inputs; 10 h and contact (B, cells, cells);
    10 times the shear (B, 2, coarse, coarse cells).

    `turn` selects one of the square's 8 symmetries.
    """

    def turned(maps: Tensor) -> Tensor:
        maps = maps.rot90(turn % 4, (1, 2))
        return maps.flip(2) if turn >= 4 else maps

    index = torch.as_tensor(index, device=data.frame.device)
    sensor = data.sensor[index]
    maps = torch.stack((turned(data.frame[index]), turned(data.reference[sensor])), 1).float() / 255
    # A turned sensor is another sensor of the family, so the maps of its geometry are not turned.
    x = torch.cat((functional.pixel_unshuffle(maps, data.fold), data.known[sensor].float()), 1)
    height, contact = (
        turned(data.height[index]).float() * HEIGHT_SCALE,
        turned(data.contact[index]).float(),
    )
    x_y = turned(data.shear[index]).float() * HEIGHT_SCALE
    for _ in range(turn % 4):  # a quarter turn of rows and columns maps x to -y and y to x
        x_y = torch.stack((x_y[..., 1], -x_y[..., 0]), -1)
    if turn >= 4:
        x_y = x_y * x_y.new_tensor((-1, 1))
    return x, height, contact, x_y.permute(0, 3, 1, 2)


LOOKS_PART = 0.3
"""Share of the frames that get another look."""
GAMMA, BLUR, GAIN, NOISE = 0.25, 0.2, 0.03, 0.02
"""Deviation of the logarithm of a sensor's gamma, greatest share that a cell takes from each
neighbour, deviation of a frame's gain, and greatest deviation of its noise (white is 0 to 1).
"""


def other_looks(maps: Tensor, generator: torch.Generator) -> Tensor:
    """Change the white of frames and references, (B, 2, cells, cells), 0 to 1.

    Dots that are thresholded larger or smaller (gamma) or seen less sharply (blur) are another
    sensor's, so frame and reference change alike. Gain and noise change only the frame.
    """

    def drawn(normal: bool) -> Tensor:
        draw = torch.randn if normal else torch.rand
        return draw((len(maps), 1, 1, 1), generator=generator, device=maps.device)

    changed = maps.clamp(min=1e-4) ** (GAMMA * drawn(True)).exp()
    blur = BLUR * drawn(False)
    for dim in (2, 3):
        pad = (1, 1, 0, 0) if dim == 3 else (0, 0, 1, 1)
        wide, cells = functional.pad(changed, pad, mode="replicate"), maps.shape[dim]
        changed = changed + blur * (
            wide.narrow(dim, 0, cells) + wide.narrow(dim, 2, cells) - 2 * changed
        )
    shown = (maps > 0).any(1, keepdim=True)  # nothing shows outside the disc
    noise = torch.randn(maps[:, :1].shape, generator=generator, device=maps.device)
    frame = changed[:, :1] * (1 + GAIN * drawn(True)) + NOISE * drawn(False) * noise
    changed = torch.cat((frame, changed[:, 1:]), 1).clamp(0, 1) * shown
    return torch.where(drawn(False) < LOOKS_PART, changed, maps)
