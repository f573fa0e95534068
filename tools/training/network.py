"""The networks: small U-Nets, whose input and output maps are folded (112x112 cells as 4 channels of 56x56: fold 2)."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

HEIGHT_SCALE = 10.0
"""The network gives h in tenths of the disc's radius: about 0 to 4."""

DISC_MM = 15.0
"""A typical disc's radius, with which figures are given in mm."""

KNOWN = 6
"""Number of maps from `disc_map.geometry_maps`."""

COARSE_CELLS = 28
"""Cells along a side of the maps of shear and of untrusted cells."""


SECOND_WIDTHS = (40, 56, 64)
"""Channels at each level of the shear network's second U."""


def block(inputs: int, outputs: int) -> nn.Sequential:
    """Make two 3x3 convolutions, each with normalisation and ReLU."""
    layers: list[nn.Module] = []
    for channels in (inputs, outputs):
        layers += [
            nn.Conv2d(channels, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        ]
    return nn.Sequential(*layers)


class U(nn.Module):
    """A U-Net: levels down, each with half as many cells per side, and up again.

    The output of a lower level is joined to the skip connection. With `added` (Chaurasia and Culurciello 2017), it is
    instead reduced to the connection's width before it is enlarged, and then added, which saves a quarter to a third
    of the arithmetic.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...], added: bool) -> None:
        super().__init__()
        self.down = nn.ModuleList(block(i, o) for i, o in zip((inputs, *widths[:-1]), widths, strict=True))
        self.up = nn.ModuleList(block(a if added else a + b, a) for a, b in pairwise(widths))
        self.narrow = nn.ModuleList(nn.Conv2d(b, a, 1, bias=False) for a, b in pairwise(widths) if added)

    def levels(self, x: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Compute each level's tensors on the way down and on the way up."""
        skips: list[Tensor] = []
        for k, layer in enumerate(self.down):
            x = layer(x if k == 0 else functional.max_pool2d(x, 2))
            skips.append(x)
        risen = [x]
        for k in reversed(range(len(self.up))):
            x = functional.interpolate(self.narrow[k](x) if self.narrow else x, scale_factor=2.0, mode="nearest")
            x = self.up[k](skips[k] + x if self.narrow else torch.cat((skips[k], x), 1))
            risen.append(x)
        return skips, risen[::-1]


class Net(U):
    """The depth network, from folded maps (B, 2 fold² + 6, N, N) to (B, 2 fold², N, N), N = cells / fold.

    The input holds the white of frame and reference, then the maps known for the sensor. The output holds 10 h / disc
    radius, then contact logits; a second output holds the log odds that a cell does not show this sensor's skin,
    (B, 1, COARSE_CELLS, COARSE_CELLS).
    """

    def __init__(
        self, fold: int = 2, widths: tuple[int, ...] = (16, 32, 48, 64), added: bool = False, cells: int = 112
    ) -> None:
        super().__init__(2 * fold * fold + KNOWN, widths, added)
        self.fold = fold
        self.head = nn.Conv2d(widths[0], 2 * fold * fold, 1)
        cells //= fold
        self.coarse_level = max(0, (cells // COARSE_CELLS).bit_length() - 1)
        cells >>= self.coarse_level
        self.coarse_fold = COARSE_CELLS // cells
        self.foreign_head = nn.Conv2d(2 * widths[self.coarse_level], self.coarse_fold**2, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Run the network."""
        skips, risen = self.levels(x)
        coarse = torch.cat((risen[self.coarse_level], skips[self.coarse_level]), 1)
        return self.head(risen[0]), functional.pixel_shuffle(self.foreign_head(coarse), self.coarse_fold)


class ShearNet(nn.Module):
    """The shear network, from maps of 112x112 cells folded by 2 (as for `Net`) to the skin's motion along itself.

    The output is 10 times the shear along x, y / disc radius, (B, 2, COARSE_CELLS, COARSE_CELLS). Two U-Nets run in
    series (Newell, Yang and Deng 2016), because an imprint shows its shear only up to whole pitches, and the
    surroundings show how many pitches. One shear network serves all profiles. It runs only on request and shares
    nothing with the depth network, which needs all of its few channels itself.
    """

    def __init__(
        self, fold: int = 2, widths: tuple[int, ...] = (16, 32, 48, 64), added: bool = False, cells: int = 112
    ) -> None:
        super().__init__()
        self.fold = fold
        if cells // fold != 2 * COARSE_CELLS:
            raise ValueError(f"{cells} cells folded by {fold}, expected {2 * COARSE_CELLS} after it")
        self.down = nn.ModuleList([block(2 * fold * fold + KNOWN, widths[0])])
        self.first = U(widths[0], widths[1:], added)
        self.second = U(2 * widths[1], SECOND_WIDTHS, added=True)
        self.head = nn.Conv2d(SECOND_WIDTHS[0], 2, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Run the network."""
        skips, risen = self.first.levels(functional.max_pool2d(self.down[0](x), 2))
        return self.head(self.second.levels(torch.cat((risen[0], skips[0]), 1))[1][0])


NETS: dict[str, type[Net] | type[ShearNet]] = {"depth": Net, "shear": ShearNet}
"""The networks that `train.py` can train."""


def trained(run: Path) -> tuple[Net | ShearNet, dict[str, Any]]:
    """Load the averaged network of a run's checkpoint, in evaluation mode, and the checkpoint."""
    state = torch.load(run / "checkpoint.pt", weights_only=True)
    widths = tuple(int(width) for width in state["arguments"]["widths"].strip("()[]").split(","))
    arguments = state["arguments"]
    made = NETS[arguments.get("net", "depth")]
    net = made(int(arguments["fold"]), widths, arguments.get("added") == "True", int(arguments.get("cells", 112)))
    net.load_state_dict({k.removeprefix("module."): v for k, v in state["mean"].items() if k.startswith("module.")})
    return net.eval(), state


def grow(net: Net, narrow: dict[str, Tensor]) -> None:
    """Give a network the weights of one that is at most as wide; until it is trained, it computes the same.

    New channels have weights of their own, but the old channels do not read them yet (Net2Net, Chen et al. 2016).
    """
    fresh = net.state_dict()
    for name, old in narrow.items():
        new = fresh[name]
        part = new.clone()
        if old.dim() == 0:
            fresh[name] = old
            continue
        if old.dim() == 1:
            part[: len(old)] = old
            fresh[name] = part
            continue
        part[: len(old)] = 0
        level = int(name.split(".")[1]) if name.startswith("up.") and name.split(".")[2] == "0" else None
        if level is None:
            part[: old.shape[0], : old.shape[1]] = old
        else:  # the skip connection's channels come first, then those from below
            skip_old = narrow[f"down.{level}.0.weight"].shape[0]
            skip_new = fresh[f"down.{level}.0.weight"].shape[0]
            part[: old.shape[0], :skip_old] = old[:, :skip_old]
            part[: old.shape[0], skip_new : skip_new + old.shape[1] - skip_old] = old[:, skip_old:]
        fresh[name] = part
    net.load_state_dict(fresh)


def add_in_place_of_joining(joined: dict[str, Tensor]) -> dict[str, Tensor]:
    """Turn the weights of a network that joins its levels into those of one that adds them, as closely as possible."""
    weights = dict(joined)
    for name, both in joined.items():
        part = name.split(".")
        if part[0] == "up" and part[2:] == ["0", "weight"]:
            skipped, risen = both.split((len(both), both.shape[1] - len(both)), dim=1)
            weights[name] = skipped
            flat = [each.permute(0, 2, 3, 1).reshape(-1, each.shape[1]) for each in (skipped, risen)]
            weights[f"narrow.{part[1]}.weight"] = torch.linalg.lstsq(*flat).solution[:, :, None, None]
    return weights
