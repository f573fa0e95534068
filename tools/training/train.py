#!/usr/bin/env python3
"""Train the network on the shards of make_data.py; run it again to continue from the last checkpoint.

::

    .venv-train/bin/python -m tools.training.train --data DATA --out RUN [--fold 4 --widths 16 32 48] [--steps 20000]

The first two shards of each kind of sensor are never trained on; they give the figures of each report. A batch depends
only on the seed and its number, so an interrupted run continues with the batches that it would have seen (while the
shards are the same).
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import os
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from tools.training.data import KINDS, Data, batch, load, shards_in
from tools.training.loss import FIGURES, LOSSES, halved
from tools.training.network import NETS, Net, ShearNet, add_in_place_of_joining, averaged, grow, like, make
from tools.training.shipped import shipped
from tools.training.torn import spoil

VALIDATION_SHARDS = 2
NEW_SHARDS = 4
"""The run loads new shards when at least this many exist."""
TORN_PART = 0.12
WARM_STEPS = 500

Batch = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Train the learned inverse.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--net", choices=NETS, default="depth", help="what is trained")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=4e-3)
    parser.add_argument("--widths", type=int, nargs="+", default=(16, 32, 48, 64))
    parser.add_argument("--fold", type=int, choices=(2, 4), default=2)
    parser.add_argument("--cells", type=int, choices=(56, 112), default=112, help="along a side of its maps")
    parser.add_argument("--shares", type=float, nargs=len(KINDS), default=(6, 1, 1, 2, 2, 8), help=" ".join(KINDS))
    parser.add_argument("--added", action="store_true", help="levels are added, not joined (`Net`)")
    parser.add_argument(
        "--start", type=Path, metavar="CHECKPOINT", help="its averaged weights begin, of the same or lesser widths"
    )
    parser.add_argument(
        "--keep-norms",
        action="store_true",
        help="normalisations keep the statistics that they begin with; --start may then be of a pruned network",
    )
    parser.add_argument("--shipped", metavar="NAME", help="the shipped weights of that name begin")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--report", type=int, default=1000, metavar="STEPS")
    return parser.parse_args()


class Run:
    """A training run: its networks, data and step, and the checkpoint from which it continues."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.args = args
        self.shards: dict[str, list[Path]] = {}
        self.check: dict[str, Data] = {}
        self.data: dict[str, Data] = {}
        self.drawn: dict[str, np.ndarray] = {}
        self.take_in()
        self.checkpoint = args.out / "checkpoint.pt"
        self.step = 0
        state: dict[str, Any] | None = None
        if self.checkpoint.exists():
            state = torch.load(self.checkpoint, weights_only=True, map_location=args.device)
            net = like(averaged(state), args.fold, args.cells)
        else:
            net = self._begin()
        if args.keep_norms:
            keep_norms(net)
        self.net = net.to(args.device, memory_format=torch.channels_last)
        self.mean = AveragedModel(self.net, multi_avg_fn=get_ema_multi_avg_fn(0.998), use_buffers=True)
        self.optimiser = torch.optim.AdamW(self.net.parameters(), args.rate, weight_decay=1e-3)
        if state is not None:
            self.net.load_state_dict(state["net"])
            self.mean.load_state_dict(state["mean"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.step = state["step"]

    def _take(self, kind: str) -> None:
        """Load the frames of a kind to train on; `drawn` holds their cumulative chances, which end at 1."""
        if kind not in self.check:
            self.check[kind] = self._load(self.shards[kind][:VALIDATION_SHARDS])
        self.data[kind] = self._load(self.shards[kind][VALIDATION_SHARDS:])
        drawn = self.data[kind]
        # Users press their own sensors deep and drag them far, so all these frames are equally likely.
        total = np.cumsum(np.ones(len(drawn.frame)) if kind == "outside" else drawn.chances())
        self.drawn[kind] = total / total[-1]

    def _load(self, paths: list[Path]) -> Data:
        return load(paths, self.args.fold, self.args.cells)

    def _begin(self) -> Net | ShearNet:
        """Make the network with its initial weights; a pruned network brings its own shape."""
        args = self.args
        net = make(args.net, args.fold, args.widths, args.added, args.cells)
        if args.shipped:
            some = [batch(frames, np.arange(0, len(frames.frame), 7))[0] for frames in self.check.values()]
            shipped(net, args.shipped, some)
        if args.start is None:
            return net
        begun = averaged(torch.load(args.start, weights_only=True, map_location="cpu"))
        if args.keep_norms:
            return like(begun, args.fold, args.cells)
        if args.added and "narrow.0.weight" not in begun:
            begun = add_in_place_of_joining(begun)
        fresh = net.state_dict()
        grow(net, {k: v for k, v in begun.items() if k in fresh and _fits(v, fresh[k])})
        return net

    def batch(self, step: int) -> Batch:
        """Make a step's batch: network inputs, height, contact, shear, and untrusted cells."""
        args, rng = self.args, np.random.default_rng((self.args.seed, step))
        share = np.array([args.shares[KINDS.index(kind)] for kind in self.data])
        counts, turn = rng.multinomial(args.batch, share / share.sum()), int(rng.integers(8))
        parts = [
            batch(self.data[kind], np.searchsorted(self.drawn[kind], rng.random(count)), turn)
            for kind, count in zip(self.data, counts, strict=True)
            if count
        ]
        x, height, contact, shear = (torch.cat(tensors) for tensors in zip(*parts, strict=True))
        untrusted = tear(x, height, contact, args.fold, rng)
        return x, height, contact, shear, untrusted

    def batches(self, pool: ThreadPoolExecutor) -> Iterator[Batch]:
        """Yield the batches of all remaining steps; threads make some of them ahead."""
        ahead: list[Future[Batch]] = []
        for step in range(self.step, self.args.steps):
            while len(ahead) < 2 * pool._max_workers and step + len(ahead) < self.args.steps:
                ahead.append(pool.submit(self.batch, step + len(ahead)))
            made = ahead.pop(0).result()
            yield tuple(tensor.to(self.args.device) for tensor in made)

    def learn(self, made: Batch) -> float:
        """Take one step and return the loss."""
        args = self.args
        warm = min(1.0, (self.step + 1) / WARM_STEPS)
        rate = args.rate * warm * (0.5 + 0.5 * math.cos(math.pi * self.step / args.steps)) + 1e-6
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        x, *true = made
        with halved(args.device):
            said = self.net(x.contiguous(memory_format=torch.channels_last))
        loss = LOSSES[args.net](said, args.fold, *true)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), 2.0)
        self.optimiser.step()
        self.mean.update_parameters(self.net)
        self.step += 1
        return float(loss.detach())

    def report(self, loss: float, s_per_step: float) -> None:
        """Print the figures of the averaged network and append them to a file."""
        row = {"step": self.step, "loss": round(loss, 4)}
        averaged = copy.deepcopy(self.mean.module).cpu().eval()
        with torch.no_grad():
            row |= {kind: FIGURES[self.args.net](averaged, frames) for kind, frames in self.check.items()}
        row |= {"frames": sum(len(d.frame) for d in self.data.values()), "s_per_step": round(s_per_step, 4)}
        print(json.dumps(row), flush=True)
        with (self.args.out / "figures.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")

    def save(self) -> None:
        """Write the checkpoint, completely or not at all."""
        state = {
            "net": self.net.state_dict(),
            "mean": self.mean.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
            "arguments": {k: str(v) for k, v in vars(self.args).items()},
            "shards": sum(map(len, self.shards.values())),
        }
        torch.save(state, self.checkpoint.with_suffix(".part"))
        os.replace(self.checkpoint.with_suffix(".part"), self.checkpoint)

    def take_in(self) -> None:
        """Load shards that were made in the meantime."""
        for kind, paths in shards_in(self.args.data).items():
            more = NEW_SHARDS if kind in self.shards else VALIDATION_SHARDS + 1
            if len(paths) >= len(self.shards.get(kind, ())) + more:
                self.shards[kind] = paths
                self._take(kind)


def tear(x: Tensor, height: Tensor, contact: Tensor, fold: int, rng: np.random.Generator) -> Tensor:
    """Spoil some frames of a batch, in place; the part of each cell that is untrusted then."""
    white, at_rest = functional.pixel_shuffle(x[:, : 2 * fold**2], fold).unbind(1)
    white = white.contiguous()
    untrusted = spoil(white, at_rest, height, contact, TORN_PART, rng)
    x[:, : fold**2] = functional.pixel_unshuffle(white[:, None], fold)
    return untrusted


def keep_norms(net: nn.Module) -> None:
    """Let each normalisation keep its statistics: a batch's differ so much that a trained network would start anew."""
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.momentum = 0.0
            module.eval()


def _fits(old: Tensor, new: Tensor) -> bool:
    """Whether weights fit into others in every dimension."""
    return old.dim() == new.dim() and all(a <= b for a, b in zip(old.shape, new.shape, strict=True))


def main() -> None:
    """Train to the last step."""
    args = arguments()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    args.out.mkdir(parents=True, exist_ok=True)
    run = Run(args)
    print(f"step {run.step}: frames { ({kind: len(d.frame) for kind, d in run.data.items()}) }", flush=True)
    start, total, since = time.perf_counter(), 0.0, run.step
    with ThreadPoolExecutor(args.threads) as pool:
        for made in run.batches(pool):
            total += run.learn(made)
            if run.step % args.report == 0 or run.step == args.steps:
                seconds, steps = time.perf_counter() - start, run.step - since
                run.report(total / steps, seconds / steps)
                run.save()
                run.take_in()
                start, total, since = time.perf_counter(), 0.0, run.step


if __name__ == "__main__":
    main()
