#!/usr/bin/env python3
"""Train the network on the shards of make_data.py; run again to go on from the last checkpoint.

::

    .venv-train/bin/python tools/train/train.py --data DATA --out RUN [--fold 4 --widths 16 32 48] [--steps 20000]

The first two shards of each kind of sensor are never trained on; they give the figures of each report. A batch depends
on the seed and its number alone, so an interrupted run goes on with the batches that it would have seen (while the
shards are the same).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from network import HEIGHT_SCALE, SHEAR_CELLS, Net, add_in_place_of_joining, grow
from shipped import shipped
from torch import Tensor
from torch.nn import functional

from tacshade_edge.core.geometry import disc_map

VALIDATION_SHARDS = 2
NEW_SHARDS = 12
"""Shards made meanwhile are taken in when they are so many."""
KINDS = ("plain", "uneven", "wide", "varied", "other")
"""Of sensors: shards from 0, 5000, 10000, 15000 and 20000 on."""
TORN_PART, FOREIGN_WEIGHT = 0.1, 0.5
FOREIGN_CELLS = 0.05
"""A frame with so many foreign cells counts as torn in the figures."""
DISC_MM = 15.0
"""A typical disc radius, to print figures in mm."""


@dataclass(slots=True, eq=False)
class Data:
    """All samples, in memory as stored; `sensor` is the row of `reference` and `known` of each frame."""

    reference: np.ndarray
    known: np.ndarray
    frame: np.ndarray
    height: np.ndarray
    contact: np.ndarray
    shear: np.ndarray
    sensor: np.ndarray
    fold: int


def shards_in(folder: Path) -> dict[str, list[Path]]:
    """The shards of each kind that is there."""
    shards: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("shard_*.npz")):
        shards.setdefault(KINDS[int(path.stem[6:]) // 5000], []).append(path)
    return shards


def load(paths: list[Path], fold: int, cells: int) -> Data:
    """Read shards, whose maps are of 112x112 cells."""
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
    """Means over by x by cells; contact where half of them touch."""
    if name == "shear":  # stored at 56x56 cells
        *first, rows, cols, two = array.shape
        by = rows // SHEAR_CELLS
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
    """Inputs of `Net`; 10 h and contact (B, cells, cells); 10 times the displacement (B, 2, SHEAR_CELLS, SHEAR_CELLS).

    `turn`: which of the square's 8 symmetries.
    """

    def turned(array: np.ndarray) -> np.ndarray:
        array = np.rot90(array, turn % 4, axes=(1, 2))
        return np.ascontiguousarray(array[:, :, ::-1] if turn >= 4 else array)

    sensor = data.sensor[index]
    maps = np.stack((turned(data.frame[index]), turned(data.reference[sensor])), axis=1)
    maps = torch.from_numpy(maps).float() / 255
    # A turned sensor is another sensor of the family, whose positions are where they were.
    known = torch.from_numpy(data.known[sensor].astype(np.float32))
    x = torch.cat((functional.pixel_unshuffle(maps, data.fold), known), 1)
    height = torch.from_numpy(turned(data.height[index]).astype(np.float32) * HEIGHT_SCALE)
    contact = np.unpackbits(data.contact[index], axis=-1)
    x_y = turned(data.shear[index].astype(np.float32) * HEIGHT_SCALE)
    for _ in range(turn % 4):  # a quarter turn of the rows and columns takes x to -y and y to x
        x_y = np.stack((x_y[..., 1], -x_y[..., 0]), axis=-1)
    if turn >= 4:
        x_y = x_y * np.array((-1, 1), np.float32)
    shear = torch.from_numpy(np.ascontiguousarray(np.moveaxis(x_y, 3, 1)))
    return x.contiguous(memory_format=torch.channels_last), height, torch.from_numpy(turned(contact)).float(), shear


def spoil(maps: Tensor, height: Tensor, contact: Tensor, part: float, rng: np.random.Generator) -> Tensor:
    """Spoil part of a batch in place, as frames are torn; what shows no skin any more has no depth and no contact.

    Parameters
    ----------
    maps, height, contact : Tensor (B, cells, cells)
        White of the frames, and what is true of them.
    part : float
    rng : numpy.random.Generator

    Returns
    -------
    Tensor (B, cells, cells)
        1 where a cell shows something else than the sensor's skin.
    """
    cells = maps.shape[-1]
    axis = (torch.arange(cells) + 0.5 - cells / 2) * (2 * disc_map.REACH / cells)
    inside = (axis[:, None] ** 2 + axis[None, :] ** 2) <= 1
    foreign = torch.zeros_like(maps)
    others = maps.clone()
    for k in np.flatnonzero(rng.random(len(maps)) < part):
        row, size = int(rng.integers(-cells // 4, 0.85 * cells)), int(rng.integers(3, cells // 2))
        row, kind = max(row, 0), int(rng.integers(4))
        end = cells if rng.random() < 0.7 else min(cells, row + int(rng.integers(6, cells)))
        frame, spoiled = maps[k], maps[k].clone()
        if kind == 0:  # the rest of the rows sideways
            spoiled[row:end] = torch.roll(frame[row:end], size * int(rng.choice((-1, 1))), 1)
        elif kind == 1:  # one row again and again
            spoiled[row:end] = frame[row]
        elif kind == 2:  # the rest of the rows further down
            spoiled[row:end] = torch.roll(frame, size, 0)[row:end]
        else:  # the rest of another sensor's
            spoiled[row:end] = others[int(rng.integers(len(maps)))][row:end]
        spoiled *= inside
        maps[k] = spoiled
        foreign[k, row:end] = 1
        foreign[k] *= inside
        height[k] *= 1 - foreign[k]
        contact[k] *= 1 - foreign[k]
    return foreign


def split_output(y: Tensor, fold: int) -> tuple[Tensor, Tensor]:
    """Height and contact logits (B, cells, cells)."""
    y = functional.pixel_shuffle(y.float(), fold)
    return y[:, 0], y[:, 1]


def loss_of(
    outputs: tuple[Tensor, Tensor, Tensor], fold: int, height: Tensor, contact: Tensor, shear: Tensor, foreign: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Of height and its slope and the contact's outline; of displacement; of what is foreign. Heavier in contact."""
    y, moved, odds = outputs
    found, logit = split_output(y, fold)
    top = height.amax((1, 2), keepdim=True)
    weight = (0.5 + 5 * contact) * (1.5 / (top + 0.7))
    off = found - height
    level = (weight * off.abs()).mean()
    slope = (weight[:, 1:] * (off[:, 1:] - off[:, :-1]).abs()).mean()
    slope = slope + (weight[:, :, 1:] * (off[:, :, 1:] - off[:, :, :-1]).abs()).mean()
    edge = functional.binary_cross_entropy_with_logits(logit, contact)
    p = torch.sigmoid(logit)
    dice = 1 - (2 * (p * contact).sum((1, 2)) + 20) / ((p + contact).sum((1, 2)) + 20)
    touching = functional.adaptive_avg_pool2d(contact[:, None], SHEAR_CELLS)
    seen = functional.adaptive_avg_pool2d(1 - foreign[:, None], SHEAR_CELLS)
    off = (moved.float() - shear).abs().sum(1, keepdim=True) * (seen > 0.99)
    strange = functional.binary_cross_entropy_with_logits(odds.float(), 1 - seen)
    return level + 1.5 * slope + edge + 0.15 * dice.mean(), ((0.3 + 4 * touching) * off).mean(), strange


def figures(net: Net, data: Data) -> dict[str, float]:
    """Errors on sensors that were not trained on, as if their disc's radius were 15 mm."""
    net.eval()
    errors, relative, ious, shapes, shears = [], [], [], [], []
    strange, torn, rng = [], [], np.random.default_rng(0)
    with torch.no_grad():
        for start in range(0, len(data.frame), 32):
            x, height, contact, shear = batch(data, np.arange(start, min(start + 32, len(data.frame))))
            white = functional.pixel_shuffle(x[:, : data.fold**2], data.fold)[:, 0]
            spoil(white, height.clone(), contact.clone(), 1.0, rng)
            spoiled = torch.cat((functional.pixel_unshuffle(white[:, None], data.fold), x[:, data.fold**2 :]), 1)
            with torch.autocast("cpu", torch.bfloat16):
                torn += list((net(spoiled)[2].float() > 0).float().mean((1, 2, 3)))
                y, moved, odds = net(x)
            strange += list((odds.float() > 0).float().mean((1, 2, 3)))
            found, logit = split_output(y, data.fold)
            touching = functional.adaptive_avg_pool2d(contact[:, None], SHEAR_CELLS)
            means = [
                (touching * each.float()).sum((2, 3)) / touching.sum((2, 3)).clamp(min=1e-3) for each in (moved, shear)
            ]
            moved_off = torch.linalg.vector_norm(means[0] - means[1], dim=1) * (DISC_MM / HEIGHT_SCALE)
            for f, h, p, c, m in zip(found, height, logit > 0, contact > 0, moved_off, strict=True):
                if c.sum() < 20:
                    continue
                shears.append(float(m))
                off = (f - h)[c] * (DISC_MM / HEIGHT_SCALE)
                errors.append(float(off.abs().mean()))
                shapes.append(float((off - off.median()).abs().mean()))
                relative.append(float(abs(f.max() / h.max() - 1)))
                ious.append(float((p & c).sum() / (p | c).sum()))
    net.train()
    names = ("error_mm", "shape_error_mm", "depth_error", "iou", "shear_error_mm")
    values = (errors, shapes, relative, ious, shears)
    row = {n: round(float(np.mean(v)), 4) for n, v in zip(names, values, strict=True)}
    return row | {"called_torn": share_over(strange, FOREIGN_CELLS), "torn": share_over(torn, FOREIGN_CELLS)}


def share_over(values: list[Tensor], limit: float) -> float:
    """The part of values over a limit."""
    return round(float(np.mean(np.array(values) > limit)), 4)


def main() -> None:
    """Train."""
    parser = argparse.ArgumentParser(description="Train the learned inverse.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=4e-3)
    parser.add_argument("--widths", type=int, nargs="+", default=(16, 32, 48, 64))
    parser.add_argument("--fold", type=int, choices=(2, 4), default=2)
    parser.add_argument("--cells", type=int, choices=(56, 112), default=112, help="along a side of its maps")
    parser.add_argument("--shares", type=float, nargs=len(KINDS), default=(3, 1, 2, 4, 0), help=" ".join(KINDS))
    parser.add_argument("--added", action="store_true", help="levels are added, not joined (`Net`)")
    parser.add_argument(
        "--start", type=Path, metavar="CHECKPOINT", help="its averaged weights begin, of the same or lesser widths"
    )
    parser.add_argument("--shipped", metavar="NAME", help="weights that are shipped begin; of depth, not displacement")
    parser.add_argument("--shear", type=float, default=1.0, help="weight of displacement in the loss")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--report", type=int, default=1000, metavar="STEPS")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    args.out.mkdir(parents=True, exist_ok=True)
    net = Net(args.fold, tuple(args.widths), args.added, args.cells).to(memory_format=torch.channels_last)
    if args.start is not None:
        averaged = torch.load(args.start, weights_only=True)["mean"]
        begun = {k.removeprefix("module."): v for k, v in averaged.items() if k.startswith("module.")}
        if args.added and "narrow.0.weight" not in begun:
            begun = add_in_place_of_joining(begun)
        grow(net, begun)
    mean = torch.optim.swa_utils.AveragedModel(
        net, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.998), use_buffers=True
    )
    optimiser = torch.optim.AdamW(net.parameters(), args.rate, weight_decay=1e-3)
    checkpoint = args.out / "checkpoint.pt"
    step = 0
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True)
        net.load_state_dict(state["net"])
        mean.load_state_dict(state["mean"])
        optimiser.load_state_dict(state["optimiser"])
        step = state["step"]
    shards = shards_in(args.data)
    check = {kind: load(paths[:VALIDATION_SHARDS], args.fold, args.cells) for kind, paths in shards.items()}
    data = {kind: load(paths[VALIDATION_SHARDS:], args.fold, args.cells) for kind, paths in shards.items()}
    if args.shipped and step == 0:
        shipped(net, args.shipped, [batch(frames, np.arange(0, len(frames.frame), 7))[0] for frames in check.values()])
        mean.module.load_state_dict(net.state_dict())
    start, total = time.perf_counter(), 0.0
    print(f"step {step}: frames { ({kind: len(d.frame) for kind, d in data.items()}) }", flush=True)
    while step < args.steps:
        rng = np.random.default_rng((args.seed, step))
        warm = min(1.0, (step + 1) / 500)
        rate = args.rate * warm * (0.5 + 0.5 * math.cos(math.pi * step / args.steps)) + 1e-6
        for group in optimiser.param_groups:
            group["lr"] = rate
        share = np.array([args.shares[KINDS.index(kind)] for kind in data])
        counts, turn = rng.multinomial(args.batch, share / share.sum()), int(rng.integers(8))
        parts = [
            batch(frames, rng.integers(len(frames.frame), size=count), turn)
            for frames, count in zip(data.values(), counts, strict=True)
            if count
        ]
        x, height, contact, shear = (torch.cat(tensors) for tensors in zip(*parts, strict=True))
        white = functional.pixel_shuffle(x[:, : args.fold**2], args.fold)[:, 0]
        foreign = spoil(white, height, contact, TORN_PART, rng)
        x[:, : args.fold**2] = functional.pixel_unshuffle(white[:, None], args.fold)
        with torch.autocast("cpu", torch.bfloat16):
            outputs = net(x)
        of_depth, of_shear, of_foreign = loss_of(outputs, args.fold, height, contact, shear, foreign)
        loss = of_depth + args.shear * of_shear + FOREIGN_WEIGHT * of_foreign
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 2.0)
        optimiser.step()
        mean.update_parameters(net)
        step += 1
        total += float(loss.detach())
        if step % args.report == 0 or step == args.steps:
            seconds = time.perf_counter() - start
            row = {"step": step, "loss": round(total / args.report, 4)}
            row |= {kind: figures(mean.module, frames) for kind, frames in check.items()}
            row |= {"frames": sum(len(d.frame) for d in data.values()), "s_per_step": round(seconds / args.report, 4)}
            print(json.dumps(row), flush=True)
            with (args.out / "figures.jsonl").open("a") as file:
                file.write(json.dumps(row) + "\n")
            state = {
                "net": net.state_dict(),
                "mean": mean.state_dict(),
                "optimiser": optimiser.state_dict(),
                "step": step,
                "arguments": {k: str(v) for k, v in vars(args).items()},
                "shards": sum(map(len, shards.values())),
            }
            torch.save(state, checkpoint.with_suffix(".part"))
            os.replace(checkpoint.with_suffix(".part"), checkpoint)
            for kind, paths in shards_in(args.data).items():
                if kind in data and len(paths) >= len(shards[kind]) + NEW_SHARDS:
                    shards[kind], data[kind] = paths, load(paths[VALIDATION_SHARDS:], args.fold, args.cells)
            start, total = time.perf_counter(), 0.0


if __name__ == "__main__":
    main()
