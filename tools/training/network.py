"""The networks: small Us; square maps go in and out folded: 112x112 as 4 channels of 56x56 (fold 2), and so on."""

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
"""The network's h is in tenths of the disc's radius: about 0 to 4."""

DISC_MM = 15.0
"""A typical disc's radius, to speak of mm."""

KNOWN = 6
"""Maps of `disc_map.geometry_maps`."""

COARSE_CELLS = 28
"""Along a side of the maps of shear and of what is untrusted."""


Widths = tuple[int, int]
"""Channels after each of a block's two convolutions."""


def block(inputs: int, widths: Widths) -> nn.Sequential:
    """Two 3x3 convolutions."""
    layers: list[nn.Module] = []
    for channels, outputs in pairwise((inputs, *widths)):
        layers += [
            nn.Conv2d(channels, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        ]
    return nn.Sequential(*layers)


def even(widths: Sequence[int]) -> tuple[list[Widths], list[Widths]]:
    """Blocks down and up whose convolutions all have their level's width."""
    return [(a, a) for a in widths], [(a, a) for a in widths[:-1]]


class U(nn.Module):
    """Levels down, each of half the cells, and up again.

    What comes up from a level is joined to what was skipped, or (`added`, Chaurasia and Culurciello 2017) brought to
    its width where it is small, and added: a quarter to a third less to compute.
    """

    def __init__(self, inputs: int, down: Sequence[Widths], up: Sequence[Widths], added: bool) -> None:
        super().__init__()
        skipped = [widths[1] for widths in down]
        below = [widths[1] for widths in (*up[1:], down[-1])]
        self.down = nn.ModuleList(block(i, o) for i, o in zip((inputs, *skipped[:-1]), down, strict=True))
        self.up = nn.ModuleList(
            block(a if added else a + b, o) for a, b, o in zip(skipped[:-1], below, up, strict=True)
        )
        self.narrow = nn.ModuleList(
            nn.Conv2d(b, a, 1, bias=False) for a, b in zip(skipped[:-1], below, strict=True) if added
        )

    def levels(self, x: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """What each level has on the way down and on the way up."""
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
    """Depth: folded maps (B, 2 fold² + 6, N, N) to (B, 2 fold², N, N), N = cells / fold.

    In: white of frame and reference, then what is known of the sensor. Out: 10 h / disc radius, then contact logits;
    and the log odds that a cell shows something else than this sensor's skin, (B, 1, COARSE_CELLS, COARSE_CELLS).
    """

    def __init__(self, fold: int, down: Sequence[Widths], up: Sequence[Widths], added: bool, cells: int) -> None:
        super().__init__(2 * fold * fold + KNOWN, down, up, added)
        self.fold = fold
        self.head = nn.Conv2d(up[0][1], 2 * fold * fold, 1)
        cells //= fold
        self.coarse_level = max(0, (cells // COARSE_CELLS).bit_length() - 1)
        cells >>= self.coarse_level
        self.coarse_fold = COARSE_CELLS // cells
        coarse = [widths[1] for widths in (*up, down[-1])][self.coarse_level] + down[self.coarse_level][1]
        self.foreign_head = nn.Conv2d(coarse, self.coarse_fold**2, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Run it."""
        skips, risen = self.levels(x)
        coarse = torch.cat((risen[self.coarse_level], skips[self.coarse_level]), 1)
        return self.head(risen[0]), functional.pixel_shuffle(self.foreign_head(coarse), self.coarse_fold)


@dataclass(frozen=True, slots=True)
class ShearWidths:
    """Widths of the network of shear: of the block at 56x56 cells, and of the blocks of both Us from 28x28 down."""

    front: Widths
    first_down: tuple[Widths, ...]
    first_up: tuple[Widths, ...]
    second_down: tuple[Widths, ...]
    second_up: tuple[Widths, ...]


SHEAR_WIDTHS = ShearWidths(
    front=(16, 16),
    first_down=((32, 32), (48, 48), (64, 64)),
    first_up=((32, 32), (48, 48)),
    second_down=((40, 40), (56, 56), (64, 64)),
    second_up=((40, 40), (56, 56)),
)


class ShearNet(nn.Module):
    """Shear: maps of 112x112 cells folded by 2, as `Net` takes them, to what the skin moved along itself.

    Out: 10 times the shear along x, y / disc radius, (B, 2, COARSE_CELLS, COARSE_CELLS). Two Us one after the
    other (Newell, Yang and Deng 2016): an imprint tells its shear up to whole pitches, what is around it how
    many. One for all profiles: it is run only where somebody asks, and shares nothing with depth, which needs all of
    its own few channels.
    """

    fold = 2

    def __init__(self, widths: ShearWidths = SHEAR_WIDTHS) -> None:
        super().__init__()
        self.down = nn.ModuleList([block(2 * self.fold**2 + KNOWN, widths.front)])
        self.first = U(widths.front[1], widths.first_down, widths.first_up, added=False)
        self.second = U(
            widths.first_up[0][1] + widths.first_down[0][1], widths.second_down, widths.second_up, added=True
        )
        self.head = nn.Conv2d(widths.second_up[0][1], 2, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Run it."""
        skips, risen = self.first.levels(functional.max_pool2d(self.down[0](x), 2))
        return self.head(self.second.levels(torch.cat((risen[0], skips[0]), 1))[1][0])


NETS = ("depth", "shear")
"""What can be trained."""


def make(net: str, fold: int, widths: Sequence[int], added: bool, cells: int) -> Net | ShearNet:
    """One of `NETS`, with equal widths within each level; shear's has a shape of its own."""
    return Net(fold, *even(widths), added, cells) if net == "depth" else ShearNet()


def like(weights: dict[str, Tensor], fold: int, cells: int) -> Net | ShearNet:
    """Make a network of the shape of some weights, and give it these."""

    def levels(way: str) -> tuple[Widths, ...]:
        count = sum(name.startswith(f"{way}.") and name.endswith(".0.weight") for name in weights)
        return tuple(tuple(len(weights[f"{way}.{k}.{place}.weight"]) for place in (0, 3)) for k in range(count))

    if "first.down.0.0.weight" in weights:
        ways = ("first.down", "first.up", "second.down", "second.up")
        net: Net | ShearNet = ShearNet(ShearWidths(levels("down")[0], *map(levels, ways)))
    else:
        net = Net(fold, levels("down"), levels("up"), "narrow.0.weight" in weights, cells)
    net.load_state_dict(weights)
    return net


def averaged(state: dict[str, Any]) -> dict[str, Tensor]:
    """The averaged weights of a checkpoint."""
    return {k.removeprefix("module."): v for k, v in state["mean"].items() if k.startswith("module.")}


def trained(run: Path) -> tuple[Net | ShearNet, dict[str, Any]]:
    """The averaged network of a run's checkpoint, to be used and not to be trained, and the checkpoint."""
    state = torch.load(run / "checkpoint.pt", weights_only=True)
    arguments = state["arguments"]
    return like(averaged(state), int(arguments["fold"]), int(arguments.get("cells", 112))).eval(), state


def grow(net: Net, narrow: dict[str, Tensor]) -> None:
    """Give a network the weights of one of lesser or equal widths; it computes the same until it is trained.

    New channels have weights of their own but are not read by the old ones yet (Net2Net, Chen et al. 2016).
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
        else:  # what was skipped comes first, then what comes up
            skip_old = narrow[f"down.{level}.0.weight"].shape[0]
            skip_new = fresh[f"down.{level}.0.weight"].shape[0]
            part[: old.shape[0], :skip_old] = old[:, :skip_old]
            part[: old.shape[0], skip_new : skip_new + old.shape[1] - skip_old] = old[:, skip_old:]
        fresh[name] = part
    net.load_state_dict(fresh)


def add_in_place_of_joining(joined: dict[str, Tensor]) -> dict[str, Tensor]:
    """Weights of a network that joins to begin one of the same widths that adds: the nearest that its layers can be."""
    weights = dict(joined)
    for name, both in joined.items():
        part = name.split(".")
        if part[0] == "up" and part[2:] == ["0", "weight"]:
            skipped, risen = both.split((len(both), both.shape[1] - len(both)), dim=1)
            weights[name] = skipped
            flat = [each.permute(0, 2, 3, 1).reshape(-1, each.shape[1]) for each in (skipped, risen)]
            weights[f"narrow.{part[1]}.weight"] = torch.linalg.lstsq(*flat).solution[:, :, None, None]
    return weights
