#!/usr/bin/env python3
"""Remove a network's least useful channels, to train what is left further.

::

    .venv-train/bin/python -m tools.training.prune --data DATA --shipped shear --multiplications 101e6 --out PRUNED
    .venv-train/bin/python -m tools.training.train --net shear --data DATA --start PRUNED/checkpoint.pt --keep-norms ...

A channel's use is estimated as in Molchanov et al. (ICLR 2017): by the first-order change in the loss if the channel
were 0, here as the root mean square over training frames. Channels go `BUNDLE` at a time, the cheapest in loss per
multiplication first, until the network needs at most the given number of multiplications for a frame.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from tools.training.data import Data, batch, load, shards_in
from tools.training.loss import FIGURES, LOSSES
from tools.training.network import Net, ShearNet, U, like, make, trained
from tools.training.shipped import shipped
from tools.training.train import VALIDATION_SHARDS, tear

BUNDLE = 8
"""Runtimes compute channels in blocks of this many."""
BATCHES, BATCH = 24, 32
SHARDS_OF_A_KIND = 3


@dataclass(slots=True)
class Wiring:
    """Which convolutions write and read each group of channels that must be removed together.

    Attributes
    ----------
    writes : dict of str to str
        The group that each convolution writes.
    reads : dict of str to list of str
        The groups that each convolution reads, in the order in which they are concatenated.
    seen : dict of str to str
        The module whose output shows each group.
    """

    writes: dict[str, str] = field(default_factory=dict)
    reads: dict[str, list[str]] = field(default_factory=dict)
    seen: dict[str, str] = field(default_factory=dict)

    def block(self, name: str, inputs: list[str]) -> str:
        """Add a block of two convolutions; the group that it writes."""
        inner, out = f"{name} inner", f"{name} out"
        self.reads |= {f"{name}.0": inputs, f"{name}.3": [inner]}
        self.writes |= {f"{name}.0": inner, f"{name}.3": out}
        self.seen |= {inner: f"{name}.2", out: f"{name}.5"}
        return out

    def u(self, net: U, prefix: str, inputs: list[str]) -> tuple[list[str], list[str]]:
        """Add a U; the groups of its levels on the way down and on the way up."""
        skipped: list[str] = []
        for k in range(len(net.down)):
            skipped.append(self.block(f"{prefix}down.{k}", inputs if k == 0 else [skipped[-1]]))
        risen = [skipped[-1]]
        for k in reversed(range(len(net.up))):
            if net.narrow:  # its result is added to what was skipped, so both are one group
                self.reads[f"{prefix}narrow.{k}"] = [risen[-1]]
                self.writes[f"{prefix}narrow.{k}"] = skipped[k]
            joined = [skipped[k]] if net.narrow else [skipped[k], risen[-1]]
            risen.append(self.block(f"{prefix}up.{k}", joined))
        return skipped, risen[::-1]


def wiring(net: Net | ShearNet) -> Wiring:
    """How a network's groups of channels are connected."""
    wired = Wiring()
    if isinstance(net, Net):
        skipped, risen = wired.u(net, "", [])
        wired.reads["head"] = [risen[0]]
        wired.reads["foreign_head"] = [risen[net.coarse_level], skipped[net.coarse_level]]
    else:
        front = wired.block("down.0", [])
        skipped, risen = wired.u(net.first, "first.", [front])
        wired.reads["head"] = [wired.u(net.second, "second.", [risen[0], skipped[0]])[1][0]]
    return wired


def uses(net: Net | ShearNet, wired: Wiring, data: Data, kind: str) -> dict[str, np.ndarray]:
    """The use of each channel of each group."""
    modules, shown = dict(net.named_modules()), dict[str, Tensor]()
    total = dict.fromkeys(wired.seen, np.zeros(()))

    def show(group: str, made: Tensor) -> None:
        made.retain_grad()
        shown[group] = made

    hooks = [
        modules[name].register_forward_hook(lambda _module, _given, made, group=group: show(group, made))
        for group, name in wired.seen.items()
    ]
    rng = np.random.default_rng(0)
    for turn in range(BATCHES):
        x, height, contact, shear = batch(data, rng.integers(0, len(data.frame), BATCH), turn % 8)
        untrusted = tear(x, height, contact, net.fold, rng)
        net.zero_grad()
        LOSSES[kind](net(x), net.fold, height, contact, shear, untrusted).backward()
        for group, made in shown.items():
            change = (made.grad * made.detach()).sum((2, 3)).square().sum(0)
            total[group] = total[group] + change.numpy()
    for hook in hooks:
        hook.remove()
    return total


def sides(net: Net | ShearNet, x: Tensor) -> dict[str, int]:
    """Results of each convolution: its rows times columns."""
    found: dict[str, int] = {}
    hooks = [
        module.register_forward_hook(
            lambda _module, _given, made, name=name: found.update({name: made.shape[2] * made.shape[3]})
        )
        for name, module in net.named_modules()
        if isinstance(module, nn.Conv2d)
    ]
    with torch.no_grad():
        net(x)
    for hook in hooks:
        hook.remove()
    return found


def kept_channels(
    net: Net | ShearNet, wired: Wiring, use: dict[str, np.ndarray], cells: dict[str, int], most: float
) -> dict[str, np.ndarray]:
    """Whether each channel of each group stays, and a network of those needs at most so many multiplications."""
    kept = {group: np.ones(len(values), bool) for group, values in use.items()}
    convs = {name: module for name, module in net.named_modules() if isinstance(module, nn.Conv2d)}

    def size(groups: list[str], otherwise: int) -> int:
        return sum(int(kept[group].sum()) for group in groups) if groups else otherwise

    def inputs(name: str) -> int:
        return size(wired.reads[name], convs[name].in_channels)

    def outputs(name: str) -> int:
        return size([wired.writes[name]] if name in wired.writes else [], convs[name].out_channels)

    def each(name: str) -> int:
        """Multiplications of one input and one output channel."""
        return convs[name].kernel_size[0] ** 2 * cells[name]

    def cost(group: str) -> int:
        """Multiplications of one channel of a group."""
        written = sum(each(name) * inputs(name) for name, of in wired.writes.items() if of == group)
        return written + sum(each(name) * outputs(name) * groups.count(group) for name, groups in wired.reads.items())

    def loss(group: str) -> float:
        least = np.sort(use[group][kept[group]])[:BUNDLE]
        return float(least.sum()) / cost(group)

    while sum(each(name) * inputs(name) * outputs(name) for name in convs) > most:
        group = min((group for group in kept if kept[group].sum() > BUNDLE), key=loss)
        there = np.flatnonzero(kept[group])
        kept[group][there[np.argsort(use[group][there])[:BUNDLE]]] = False
    return kept


def pruned(net: Net | ShearNet, wired: Wiring, kept: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """The weights of the channels that stay."""
    weights = net.state_dict()
    for name, groups in wired.reads.items():
        if groups:
            inputs = torch.from_numpy(np.concatenate([kept[group] for group in groups]))
            weights[f"{name}.weight"] = weights[f"{name}.weight"][:, inputs]
    for name, group in wired.writes.items():
        outputs = torch.from_numpy(kept[group])
        weights[f"{name}.weight"] = weights[f"{name}.weight"][outputs]
        block, _, place = name.rpartition(".")
        norm = f"{block}.{int(place) + 1}"
        for part in ("weight", "bias", "running_mean", "running_var"):
            if f"{norm}.{part}" in weights and not block.endswith("narrow"):
                weights[f"{norm}.{part}"] = weights[f"{norm}.{part}"][outputs]
    return weights


def report(when: str, net: Net | ShearNet, check: dict[str, Data], kind: str) -> None:
    """Print the figures on shards that are never trained on."""
    with torch.no_grad():
        row = {name: FIGURES[kind](net, frames) for name, frames in check.items()}
    print(json.dumps({"when": when} | row), flush=True)


def main() -> None:
    """Prune and write a checkpoint that `train --start` begins with."""
    parser = argparse.ArgumentParser(description="Remove a network's least useful channels.")
    parser.add_argument("--data", type=Path, required=True)
    begun = parser.add_mutually_exclusive_group(required=True)
    begun.add_argument("--run", type=Path, help="of which to prune the averaged weights")
    begun.add_argument("--shipped", metavar="NAME", help="the shipped weights to prune")
    parser.add_argument("--net", default="shear")
    parser.add_argument("--widths", type=int, nargs="+", default=(16, 32, 48, 64))
    parser.add_argument("--fold", type=int, default=2)
    parser.add_argument("--cells", type=int, default=112)
    parser.add_argument("--added", action="store_true")
    parser.add_argument("--multiplications", type=float, required=True, help="at most so many stay, for a frame")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    torch.set_num_threads(1)
    shards = shards_in(args.data)
    data = load(
        [path for paths in shards.values() for path in paths[VALIDATION_SHARDS:][:SHARDS_OF_A_KIND]],
        args.fold,
        args.cells,
    )
    if args.run:
        net = trained(args.run)[0]
    else:
        net = make(args.net, args.fold, args.widths, args.added, args.cells)
        some = [load(paths[:1], args.fold, args.cells) for paths in shards.values()]
        shipped(net, args.shipped, [batch(each, np.arange(0, len(each.frame), 7))[0] for each in some])
    net.eval()
    for module in net.modules():
        if isinstance(module, nn.ReLU):
            module.inplace = False
    check = {kind: load(paths[:VALIDATION_SHARDS], args.fold, args.cells) for kind, paths in shards.items()}
    report("before", net, check, args.net)
    wired = wiring(net)
    cells = sides(net, batch(data, np.arange(1))[0])
    kept = kept_channels(net, wired, uses(net, wired, data, args.net), cells, args.multiplications)
    for group, stays in kept.items():
        print(f"{group}: {stays.sum()} of {len(stays)}")
    args.out.mkdir(parents=True, exist_ok=True)
    weights = pruned(net, wired, kept)
    report("after", like(weights, args.fold, args.cells).eval(), check, args.net)
    torch.save({"mean": {f"module.{name}": value for name, value in weights.items()}}, args.out / "checkpoint.pt")


if __name__ == "__main__":
    main()
