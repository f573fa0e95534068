"""The networks: small U-Nets, whose input and output maps are folded
(112x112 cells as 4 channels of 56x56: fold 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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


Widths = tuple[int, int]
"""Channels after each of a block's two convolutions."""


def block(inputs: int, widths: Widths) -> nn.Sequential:
    """Make two 3x3 convolutions, each with normalisation and ReLU."""
    layers: list[nn.Module] = []
    for channels, outputs in pairwise((inputs, *widths)):
        layers += [
            nn.Conv2d(channels, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        ]
    return nn.Sequential(*layers)


def even(widths: Sequence[int]) -> tuple[list[Widths], list[Widths]]:
    """Give all convolutions of a level the same width; the widths of the blocks down and up."""
    return [(a, a) for a in widths], [(a, a) for a in widths[:-1]]


class U(nn.Module):
    """A U-Net: levels down, each with half as many cells per side, and up again.

    The output of a lower level is joined to the skip connection. With `added` (Chaurasia and
    Culurciello 2017), it is instead reduced to the connection's width before it is enlarged, and
    then added, which saves a quarter to a third of the arithmetic.
    """

    def __init__(
        self, inputs: int, down: Sequence[Widths], up: Sequence[Widths], added: bool
    ) -> None:
        super().__init__()
        skipped = [widths[1] for widths in down]
        below = [widths[1] for widths in (*up[1:], down[-1])]
        self.down = nn.ModuleList(
            block(i, o) for i, o in zip((inputs, *skipped[:-1]), down, strict=True)
        )
        self.up = nn.ModuleList(
            block(a if added else a + b, o) for a, b, o in zip(skipped[:-1], below, up, strict=True)
        )
        self.narrow = nn.ModuleList(
            nn.Conv2d(b, a, 1, bias=False)
            for a, b in zip(skipped[:-1], below, strict=True)
            if added
        )

    def levels(self, x: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Compute each level's tensors on the way down and on the way up."""
        skips: list[Tensor] = []
        for k, layer in enumerate(self.down):
            x = layer(x if k == 0 else functional.max_pool2d(x, 2))
            skips.append(x)
        risen = [x]
        for k in reversed(range(len(self.up))):
            x = functional.interpolate(
                self.narrow[k](x) if self.narrow else x, scale_factor=2.0, mode="nearest"
            )
            x = self.up[k](skips[k] + x if self.narrow else torch.cat((skips[k], x), 1))
            risen.append(x)
        return skips, risen[::-1]


class Net(U):
    """The depth network, from folded maps (B, 2 fold² + 6, N, N) to (B, 2 fold², N, N),
    N = cells / fold.

    The input holds the white of frame and reference, then the maps known for the sensor. The output
    holds 10 h / disc radius, then contact logits; a second output holds the log odds that a cell
    does not show this sensor's skin, (B, 1, COARSE_CELLS, COARSE_CELLS).
    """

    def __init__(self, fold: int, down: Sequence[Widths], up: Sequence[Widths], cells: int) -> None:
        super().__init__(2 * fold * fold + KNOWN, down, up, added=True)
        self.fold = fold
        self.head = nn.Conv2d(up[0][1], 2 * fold * fold, 1)
        cells //= fold
        self.coarse_level = max(0, (cells // COARSE_CELLS).bit_length() - 1)
        cells >>= self.coarse_level
        self.coarse_fold = COARSE_CELLS // cells
        coarse = [widths[1] for widths in (*up, down[-1])][self.coarse_level] + down[
            self.coarse_level
        ][1]
        self.foreign_head = nn.Conv2d(coarse, self.coarse_fold**2, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Run the network."""
        skips, risen = self.levels(x)
        coarse = torch.cat((risen[self.coarse_level], skips[self.coarse_level]), 1)
        return self.head(risen[0]), functional.pixel_shuffle(
            self.foreign_head(coarse), self.coarse_fold
        )


@dataclass(frozen=True, slots=True)
class ShearWidths:
    """Widths of the shear network: of its block at 56x56 cells,
    and of the blocks of both U-Nets from 28x28 down.
    """

    front: Widths
    first_down: tuple[Widths, ...]
    first_up: tuple[Widths, ...]
    second_down: tuple[Widths, ...]
    second_up: tuple[Widths, ...]


SHEAR_WIDTHS = ShearWidths(
    front=(16, 16),
    first_down=((24, 24), (32, 32), (48, 48)),
    first_up=((24, 24), (32, 32)),
    second_down=((24, 24), (40, 40), (64, 64)),
    second_up=((24, 24), (40, 40)),
)


class ShearNet(nn.Module):
    """The shear network, from maps of 112x112 cells folded by 2
    (as for `Net`) to the skin's motion along itself.

    The output is 10 times the shear along x, y / disc radius, (B, 2, COARSE_CELLS, COARSE_CELLS).
    Two U-Nets run in series (Newell, Yang and Deng 2016), because an imprint shows its shear only
    up to whole pitches, and the surroundings show how many pitches. One shear network serves all
    profiles. It runs only on request and shares nothing with the depth network, which needs all of
    its few channels itself.
    """

    fold = 2

    def __init__(self, widths: ShearWidths = SHEAR_WIDTHS) -> None:
        super().__init__()
        self.down = nn.ModuleList([block(2 * self.fold**2 + KNOWN, widths.front)])
        self.first = U(widths.front[1], widths.first_down, widths.first_up, added=False)
        self.second = U(
            widths.first_up[0][1] + widths.first_down[0][1],
            widths.second_down,
            widths.second_up,
            added=True,
        )
        self.head = nn.Conv2d(widths.second_up[0][1], 2, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Run the network."""
        skips, risen = self.first.levels(functional.max_pool2d(self.down[0](x), 2))
        return self.head(self.second.levels(torch.cat((risen[0], skips[0]), 1))[1][0])


NETS = ("depth", "shear")
"""The networks that `train.py` can train."""


def make(net: str, fold: int, widths: Sequence[int], cells: int) -> Net | ShearNet:
    """Make one of `NETS`, with one width for each level; the shear network has `SHEAR_WIDTHS`."""
    return Net(fold, *even(widths), cells) if net == "depth" else ShearNet()


def like(weights: dict[str, Tensor], fold: int, cells: int) -> Net | ShearNet:
    """Make a network that has the shape of these weights, and load them."""

    def levels(way: str) -> tuple[Widths, ...]:
        count = sum(name.startswith(f"{way}.") and name.endswith(".0.weight") for name in weights)
        return tuple(
            tuple(len(weights[f"{way}.{k}.{place}.weight"]) for place in (0, 3))
            for k in range(count)
        )

    if "first.down.0.0.weight" in weights:
        ways = ("first.down", "first.up", "second.down", "second.up")
        net: Net | ShearNet = ShearNet(ShearWidths(levels("down")[0], *map(levels, ways)))
    else:
        net = Net(fold, levels("down"), levels("up"), cells)
    net.load_state_dict(weights)
    return net


def averaged(state: dict[str, Any]) -> dict[str, Tensor]:
    """Return a checkpoint's averaged weights."""
    return {
        k.removeprefix("module."): v for k, v in state["mean"].items() if k.startswith("module.")
    }


def trained(run: Path) -> tuple[Net | ShearNet, dict[str, Any]]:
    """Load the averaged network of a run's checkpoint, in evaluation mode, and the checkpoint."""
    state = torch.load(run / "checkpoint.pt", weights_only=True, map_location="cpu")
    arguments = state["arguments"]
    return like(
        averaged(state), int(arguments["fold"]), int(arguments.get("cells", 112))
    ).eval(), state
