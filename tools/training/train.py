"""Train the network on the shards of make_data.py;
run it again to continue from the last checkpoint.

::

    .venv-train/bin/python -m tools.training.train --data DATA --out RUN
        [--fold 4 --widths 16 32 48] [--steps 20000]

The first two shards of each kind of sensor are never trained on; they give the figures of each
report. A batch depends only on the seed and its number, so an interrupted run continues with the
batches that it would have seen (while the shards are the same). A run that is done only reports.

It begins when each kind has three shards. On a GPU, all frames lie in its memory, and a step is a
CUDA graph. Several runs can share a GPU, and the shards may be made meanwhile.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from tacshade_edge.lab.fitting.losses import LOSSES
from tacshade_edge.lab.fitting.spoilt_frames import spoil
from tacshade_edge.lab.fitting.training import halved
from tacshade_edge.sensor.inference.network import WEIGHTS
from tools.training.data import Data, batch, joined, load, other_looks, shards_in
from tools.training.figures import FIGURES
from tools.training.network import NETS, Net, ShearNet, averaged, like, make
from tools.training.samples import KINDS, SHARES


def shipped(net: Net | ShearNet, name: str, inputs: list[Tensor]) -> None:
    """Give a network the shipped weights, so that it computes the same as the shipped network.

    The inputs are frames as it takes them, which determine each normalisation's mean and variance.
    """
    frame, sensor = (_tensors(WEIGHTS / f"{name}{end}") for end in (".onnx", ".sensor.onnx"))
    named = {
        key.removeprefix("rest."): frame.pop(key) for key in list(frame) if key.startswith("rest.")
    }
    net.load_state_dict(named, strict=False)
    first = torch.cat((frame.pop("weight"), sensor["weight"]), 1), sensor["bias"]
    rest = list(frame.values())
    folded = [first, *zip(rest[::2], rest[1::2], strict=True)]
    pairs = [(part[k], part[k + 1]) for part in _blocks(net) for k in (0, 3)]
    net.eval()
    with torch.no_grad():
        for (conv, norm), (weight, bias) in zip(pairs, folded, strict=True):
            conv.weight.copy_(weight)
            norm.reset_running_stats()
            norm.weight.copy_(torch.full_like(bias, (1 + norm.eps) ** 0.5))
            norm.bias.copy_(bias)
        for conv, norm in pairs:  # all layers before this one are final already
            _measured(net, conv, norm, inputs)
    net.train()


def _blocks(net: Net | ShearNet) -> list[nn.Module]:
    """List the blocks in the order in which the network runs them."""
    us = [net] if isinstance(net, Net) else [net.first, net.second]
    before = [] if isinstance(net, Net) else list(net.down)
    return before + [part for u in us for part in (*u.down, *reversed(u.up))]


def _measured(net: Net | ShearNet, conv: nn.Module, norm: nn.Module, inputs: list[Tensor]) -> None:
    """Set a normalisation's statistics to those of its convolution's output,
    and its scale and shift to undo them.
    """
    seen: list[Tensor] = []
    hook = conv.register_forward_hook(
        lambda _module, _given, made: seen.append(made.transpose(0, 1).flatten(1))
    )
    for x in inputs:
        net(x)
    hook.remove()
    values = torch.cat(seen, 1)
    norm.running_mean.copy_(values.mean(1))
    norm.running_var.copy_(values.var(1))
    norm.weight.copy_((norm.running_var + norm.eps).sqrt())
    norm.bias.add_(norm.running_mean)


def _tensors(path: Path) -> dict[str, Tensor]:
    return {
        each.name: torch.from_numpy(numpy_helper.to_array(each).copy())
        for each in onnx.load(path).graph.initializer
    }


VALIDATION_SHARDS = 2
NEW_SHARDS = 4
"""The run loads new shards of a kind when at least this many exist."""
LOOK_STEPS, SAVE_STEPS = 200, 1000
"""After so many steps, it looks for new shards, and writes its checkpoint."""
TORN_PART = 0.12
WARM_STEPS = 500
CAPTURED_AFTER, WAIT_S = 3, 0.5

Batch = tuple[Tensor, ...]
"""Inputs, then the true height, contact and shear, and the untrusted cells."""


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Train the learned inverse.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--net", choices=NETS, default="depth", help="what is trained")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="ends the run before its last step"
    )
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=4e-3)
    parser.add_argument("--widths", type=int, nargs="+", default=(16, 32, 48, 64))
    parser.add_argument("--fold", type=int, choices=(2, 4), default=2)
    parser.add_argument(
        "--cells", type=int, choices=(56, 112), default=112, help="along a side of its maps"
    )
    parser.add_argument("--shipped", metavar="NAME", help="the shipped weights of that name begin")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--report", type=int, default=1000, metavar="STEPS", help="0: never")
    return parser.parse_args()


class Run:
    """A training run: its networks, data and step, and the checkpoint from which it continues."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.args = args
        self.shards: dict[str, list[Path]] = {}
        self.check: dict[str, Data] = {}
        self.data: dict[str, Data] = {}
        self.drawn: dict[str, Tensor] = {}
        self.take_in()
        if len(self.data) < len(KINDS):
            print(
                (
                    f"{args.data}: waiting for {VALIDATION_SHARDS + 1} shards of each kind "
                    "(make_data.py)"
                ),
                flush=True,
            )
        while len(self.data) < len(KINDS):
            time.sleep(WAIT_S)
            self.take_in()
        self.checkpoint = args.out / "checkpoint.pt"
        self.step, self.began = 0, time.time()
        state: dict[str, Any] | None = None
        if self.checkpoint.exists():
            state = torch.load(self.checkpoint, weights_only=True, map_location="cpu")
            net = like(averaged(state), args.fold, args.cells)
        else:
            net = self._begin()
        self.net = net.to(args.device, memory_format=torch.channels_last)
        self.mean = AveragedModel(
            self.net, multi_avg_fn=get_ema_multi_avg_fn(0.998), use_buffers=True
        )
        self.mean.n_averaged = (
            self.mean.n_averaged.cpu()
        )  # it is compared at every step, which should not wait
        self.rate = torch.zeros((), device=args.device)
        on_gpu = self.rate.is_cuda
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(),
            self.rate,
            weight_decay=1e-3,
            capturable=on_gpu,
            fused=on_gpu or None,
        )
        if state is not None:
            self.net.load_state_dict(state["net"])
            self.mean.load_state_dict(state["mean"])
            self.optimiser.load_state_dict(state["optimiser"])
            for group in self.optimiser.param_groups:
                group |= {"lr": self.rate, "capturable": on_gpu, "fused": on_gpu or None}
            self.step = state["step"]
            self.began -= state["seconds"]
        self.learn: Callable[[Batch], Tensor] = Captured(self._learn) if on_gpu else self._learn

    def _begin(self) -> Net | ShearNet:
        """Make the network with its initial weights."""
        args = self.args
        net = make(args.net, args.fold, args.widths, args.cells)
        if args.shipped:
            check = self.check.values()
            some = [batch(frames, np.arange(0, len(frames.frame), 7))[0].cpu() for frames in check]
            shipped(net, args.shipped, some)
        return net

    def batch(self) -> Batch:
        """Make a step's batch: network inputs, height, contact, shear, and untrusted cells."""
        args, rng = self.args, np.random.default_rng((self.args.seed, self.step))
        generator = torch.Generator(args.device).manual_seed(int(rng.integers(1 << 62)))
        share = np.array([SHARES[KINDS.index(kind)] for kind in self.data])
        counts, parts = rng.multinomial(args.batch, share / share.sum()), []
        for kind, count in zip(self.data, counts, strict=True):
            if count:
                drawn = torch.rand(
                    int(count), generator=generator, device=args.device, dtype=torch.float64
                )
                index = torch.searchsorted(self.drawn[kind], drawn)
                parts.append(batch(self.data[kind], index, int(rng.integers(8))))
        x, height, contact, shear = (torch.cat(tensors) for tensors in zip(*parts, strict=True))
        fold = args.fold
        maps = other_looks(functional.pixel_shuffle(x[:, : 2 * fold**2], fold), generator)
        x = torch.cat((functional.pixel_unshuffle(maps, fold), x[:, 2 * fold**2 :]), 1)
        untrusted = tear(x, height, contact, fold, rng)
        return (
            x.contiguous(memory_format=torch.channels_last),
            height,
            contact,
            shear.contiguous(),
            untrusted,
        )

    def done(self) -> float:
        """How much of the run is done, in steps or in time, 0 to 1."""
        return max(
            self.step / self.args.steps, (time.time() - self.began) / (60 * self.args.minutes)
        )

    def take_step(self) -> Tensor:
        """Take one step and return the loss."""
        warm = min(1.0, (self.step + 1) / WARM_STEPS)
        self.rate.fill_(
            self.args.rate * warm * (0.5 + 0.5 * math.cos(math.pi * min(self.done(), 1.0))) + 1e-6
        )
        loss = self.learn(self.batch())
        self.mean.update_parameters(self.net)
        self.step += 1
        return loss

    def _learn(self, made: Batch) -> Tensor:
        x, *true = made
        with halved(self.args.device):
            said = self.net(x)
        loss = LOSSES[self.args.net](said, self.args.fold, *true)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), 2.0)
        self.optimiser.step()
        return loss.detach()

    def report(self, loss: float, s_per_step: float) -> None:
        """Print the figures of the averaged network and append them to a file."""
        row = {"step": self.step, "loss": round(loss, 4)}
        averaged = copy.deepcopy(self.mean.module).eval()
        with torch.no_grad():
            row |= {
                kind: FIGURES[self.args.net](averaged, frames)
                for kind, frames in self.check.items()
            }
        row |= {"s_per_step": round(s_per_step, 4)}
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
            "seconds": time.time() - self.began,
            "arguments": {k: str(v) for k, v in vars(self.args).items()},
            "shards": sum(map(len, self.shards.values())),
        }
        torch.save(state, self.checkpoint.with_suffix(".part"))
        os.replace(self.checkpoint.with_suffix(".part"), self.checkpoint)

    def take_in(self) -> None:
        """Load shards that were made in the meantime."""
        args = self.args
        for kind, paths in shards_in(args.data).items():
            known = self.shards.get(kind, [])
            fresh = [path for path in paths if path not in known]
            if len(fresh) < (NEW_SHARDS if known else VALIDATION_SHARDS + 1):
                continue
            if not known:
                self.check[kind] = load(
                    paths[:VALIDATION_SHARDS], args.fold, args.cells, args.device
                )
            more = [path for path in fresh if path not in paths[:VALIDATION_SHARDS]]
            loaded = load(more, args.fold, args.cells, args.device)
            self.data[kind] = joined([self.data[kind], loaded]) if known else loaded
            self.shards[kind] = [*known, *fresh]
            # Users press their own sensors deep and drag them far,
            # so all these frames are equally likely.
            kept = self.data[kind]
            total = (
                (torch.ones(len(kept.frame)) if kind == "outside" else kept.chances())
                .double()
                .cumsum(0)
            )
            self.drawn[kind] = (total / total[-1]).to(args.device)


class Captured:
    """A step that is captured as a CUDA graph after `CAPTURED_AFTER` calls and replayed
    from then on.
    """

    def __init__(self, step: Callable[[Batch], Tensor]) -> None:
        self.step, self.calls = step, 0
        self.graph, self.stream = torch.cuda.CUDAGraph(), torch.cuda.Stream()
        self.inputs: Batch = ()
        self.loss = torch.zeros(())

    def __call__(self, made: Batch) -> Tensor:
        """Take the step."""
        self.calls += 1
        if self.calls <= CAPTURED_AFTER:
            self.stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(self.stream):
                loss = self.step(made)
            torch.cuda.current_stream().wait_stream(self.stream)
            return loss
        if not self.inputs:
            self.inputs = tuple(tensor.clone() for tensor in made)
            with torch.cuda.graph(self.graph):
                self.loss = self.step(self.inputs)
        for kept, new in zip(self.inputs, made, strict=True):
            kept.copy_(new)
        self.graph.replay()
        return self.loss.clone()


def tear(x: Tensor, height: Tensor, contact: Tensor, fold: int, rng: np.random.Generator) -> Tensor:
    """Spoil some frames of a batch, in place; the part of each cell that is untrusted then."""
    white, at_rest = functional.pixel_shuffle(x[:, : 2 * fold**2], fold).unbind(1)
    white = white.contiguous()
    untrusted = spoil(white, at_rest, height, contact, TORN_PART, rng)
    x[:, : fold**2] = functional.pixel_unshuffle(white[:, None], fold)
    return untrusted


def main() -> None:
    """Train to the last step."""
    args = arguments()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    torch.backends.cudnn.benchmark = True
    args.out.mkdir(parents=True, exist_ok=True)
    run = Run(args)
    print(
        f"step {run.step}: frames { ({kind: len(d.frame) for kind, d in run.data.items()}) }",
        flush=True,
    )
    start, total, since = time.perf_counter(), torch.zeros((), device=args.device), run.step

    def report() -> None:
        nonlocal start, since
        seconds, steps = time.perf_counter() - start, max(1, run.step - since)
        run.report(float(total) / steps, seconds / steps)
        start, since = time.perf_counter(), run.step
        total.zero_()

    finished = run.done() >= 1
    while run.done() < 1:
        total += run.take_step()
        if run.step % LOOK_STEPS == 0:
            run.take_in()
        if run.step % SAVE_STEPS == 0:
            run.save()
        if args.report and run.step % args.report == 0:
            report()
    if not finished:
        run.save()
    if args.report:
        report()


if __name__ == "__main__":
    main()
