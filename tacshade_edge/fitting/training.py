"""Train a shipped network on a twin's frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tacshade_edge.core.depth.learned import HEIGHT_SCALE
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.fitting.twin import HALVED, WHOLE, Frames
from tacshade_edge.inference.network import network_files, network_size
from tacshade_edge.inference.onnx_weights import nodes_of, values_of, weights_of
from tacshade_edge.types import F32, Calibration

Operation = Callable[[dict[str, Any], list[Tensor]], Tensor]


def _convolution(attributes: dict[str, Any], given: list[Tensor]) -> Tensor:
    x, weight = given[:2]
    return functional.conv2d(
        x, weight, given[2] if len(given) > 2 else None, padding=attributes["pads"][0]
    )


def _pool(attributes: dict[str, Any], given: list[Tensor]) -> Tensor:
    return functional.max_pool2d(given[0], attributes["kernel_shape"][0], attributes["strides"][0])


OPERATIONS: dict[str, Operation] = {
    "Conv": _convolution,
    "Relu": lambda _, given: functional.relu(given[0]),
    "Add": lambda _, given: given[0] + given[1],
    "Concat": lambda _, given: torch.cat(given, 1),
    "MaxPool": _pool,
    # As the networks use it: twice as many cells along each side, each a copy of the nearest.
    "Resize": lambda _, given: functional.interpolate(given[0], scale_factor=2.0, mode="nearest"),
    "DepthToSpace": lambda attributes, given: functional.pixel_shuffle(
        given[0], attributes["blocksize"]
    ),
}
"""The operations in the graphs that tools/training/export.py writes."""
_ONCE = "once:"


class TorchNetwork:
    """A network in training.

    Its normalisation is part of the weights, so it stays as it was learnt on many sensors. `name`:
    of a shipped network. Raises ValueError (the file has an operation that is not in `OPERATIONS`).
    """

    def __init__(self, name: str) -> None:
        frame, once = network_files(name)
        self._nodes = [node for node in nodes_of(frame) if node.kind != "Constant"]
        if unknown := {node.kind for node in self._nodes} - set(OPERATIONS):
            raise ValueError(f"operations {', '.join(sorted(unknown))} are not known here")
        self._weights: dict[str, Tensor] = {}
        for prefix, data in (("", frame), (_ONCE, once)):
            values, at = torch.from_numpy(values_of(data)), 0
            for weight in weights_of(data):
                size = (weight.end - weight.begin) // 4
                # Channels last: 1.4 to 2.4 times as fast on a processor.
                made = values[at : at + size].reshape(weight.shape).clone()
                made = (
                    made.contiguous(memory_format=torch.channels_last) if made.dim() == 4 else made
                )
                self._weights[prefix + weight.name] = made.requires_grad_()
                at += size

    def parameters(self) -> list[Tensor]:
        """The tensors that training changes: all weights."""
        return list(self._weights.values())

    def __call__(self, white: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
        """Run frames: depth and contact (B, 2 fold², N, N) and untrusted log odds (B, 1, M, M).

        `white`: Tensor float32 (B, fold², N, N). `known` (Tensor float32 (B, fold² + 6, N, N)):
        what is known of each frame's sensor (`core.depth.learned.known_maps`).
        """
        once = [weight for name, weight in self._weights.items() if name.startswith(_ONCE)]
        weight = next(each for each in once if each.dim() == 4)
        bias = next(each for each in once if each.dim() == 1)
        values = self._weights | {
            "white": white,
            "sensor": functional.conv2d(known, weight, bias, padding=1),
        }
        for node in self._nodes:
            given = [values[name] for name in node.inputs if name in values]
            values[node.output] = OPERATIONS[node.kind](node.attributes, given)
        return values["depth_and_contact"], values["foreign"]

    def load(self, flat: F32) -> None:
        """Replace all weights with those of `flat`."""
        at = 0
        for weight in self._weights.values():
            size = weight.numel()
            with torch.no_grad():
                weight.copy_(torch.from_numpy(flat[at : at + size].copy()).reshape(weight.shape))
            at += size

    def flat(self) -> F32:
        """All weights end to end, those of every frame first, in the order of
        `onnx_weights.values_of`.
        """
        flat: F32 = torch.cat(
            [weight.detach().flatten() for weight in self._weights.values()]
        ).numpy()
        return flat


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


COARSE_CELLS = 28
"""Cells along a side of the maps of shear and of untrusted cells."""
UNTRUSTED_WEIGHT = 0.5


def split_output(y: Tensor, fold: int) -> tuple[Tensor, Tensor]:
    """Split a network's output into height and contact logits (B, cells, cells)."""
    y = functional.pixel_shuffle(y.float(), fold)
    return y[:, 0], y[:, 1]


def depth_loss(
    outputs: tuple[Tensor, Tensor],
    fold: int,
    height: Tensor,
    contact: Tensor,
    shear: Tensor,
    untrusted: Tensor,
) -> Tensor:
    """Sum the losses of height and its slope (weighted higher in contact), of contact,
    and of untrusted cells.
    """
    y, odds = outputs
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
    seen = functional.adaptive_avg_pool2d(1 - untrusted[:, None], COARSE_CELLS)
    strange = functional.binary_cross_entropy_with_logits(odds.float(), 1 - seen)
    return level + 1.5 * slope + edge + 0.15 * dice.mean() + UNTRUSTED_WEIGHT * strange


def shear_loss(
    moved: Tensor, fold: int, height: Tensor, contact: Tensor, shear: Tensor, untrusted: Tensor
) -> Tensor:
    """Compute the loss of shear where the skin is visible, weighted higher in contact."""
    touching = functional.adaptive_avg_pool2d(contact[:, None], COARSE_CELLS)
    seen = functional.adaptive_avg_pool2d(1 - untrusted[:, None], COARSE_CELLS)
    off = (moved.float() - shear).abs().sum(1, keepdim=True) * (seen > 0.99)
    return ((0.3 + 4 * touching) * off).mean()


LOSSES: dict[str, Callable[..., Tensor]] = {"depth": depth_loss, "shear": shear_loss}
"""The loss of each of `network.NETS`, from its output, its fold and the true maps."""


BATCH, AT_ONCE = 24, 12
"""The gradient of a batch is summed over parts, which halves the memory."""
RATE = 1e-3
"""Greatest learning rate of one cycle (Smith and Topin, 2019) of AdamW."""
WARM_PART, DECAY = 0.15, 1e-3
TORN_PART = 0.12
OWN_PART = 0.3
"""Share of the steps that always see the sensor as it is; the others turn or mirror it."""
USUAL_DEPTH, USUAL_DRAG, STILL = 0.24, 0.16, 0.0075
"""In skin radii: presses up to this depth and drags up to this length are drawn more often,
and undragged ones too.
"""
LEAST_CELLS = 60
"""A contact with fewer cells (of 112x112) is not judged."""


@dataclass(frozen=True, slots=True, eq=False)
class Maps:
    """A twin's frames for a network.

    `known`: Tensor float32 (6, N, N). `reference`, `white`: Tensor uint8 (S or F, cells, cells).
    `sensor`: Tensor int64 (F,). `height`: Tensor float16 (F, cells, cells), in disc radii.
    `contact`: Tensor bool (F, cells, cells). `shear`: Tensor float32 (F, 2, COARSE_CELLS,
    COARSE_CELLS), in disc radii.
    """

    fold: int
    known: Tensor
    reference: Tensor
    white: Tensor
    sensor: Tensor
    height: Tensor
    contact: Tensor
    shear: Tensor

    def batch(self, index: Tensor, turn: int) -> tuple[Tensor, ...]:
        """White of frames and their references, then height,
        contact and shear in the network's units.

        `turn` selects one of the square's 8 symmetries;
        a turned sensor is another sensor with the same geometry.
        """

        def turned(maps: Tensor) -> Tensor:
            maps = maps.rot90(turn % 4, (-2, -1))
            return maps.flip(-1) if turn >= 4 else maps

        white, at_rest = (
            turned(each).float() / 255
            for each in (self.white[index], self.reference[self.sensor[index]])
        )
        height, contact = (
            turned(self.height[index]).float() * HEIGHT_SCALE,
            turned(self.contact[index]).float(),
        )
        shear = turned(self.shear[index]) * HEIGHT_SCALE
        for _ in range(turn % 4):  # a quarter turn of rows and columns maps x to -y and y to x
            shear = torch.stack((shear[:, 1], -shear[:, 0]), 1)
        if turn >= 4:
            shear = shear * shear.new_tensor((-1, 1))[:, None, None]
        return tuple(each.contiguous() for each in (white, at_rest, height, contact, shear))

    def inputs(self, white: Tensor, at_rest: Tensor) -> tuple[Tensor, Tensor]:
        """The network's inputs."""
        known = self.known.expand(len(white), -1, -1, -1)
        known = torch.cat((functional.pixel_unshuffle(at_rest[:, None], self.fold), known), 1)
        last = torch.channels_last
        white = functional.pixel_unshuffle(white[:, None], self.fold)
        return white.contiguous(memory_format=last), known.contiguous(memory_format=last)

    def chances(self, skin_radii: float) -> Tensor:
        """Weight each frame for drawing: presses like those of users come more often.

        `skin_radii`: of the disc.
        """
        depth = self.height.flatten(1).amax(1).float() * skin_radii
        touching = functional.adaptive_avg_pool2d(self.contact[:, None].float(), COARSE_CELLS)
        part = touching.sum((2, 3)).clamp(min=1e-6)
        drag = ((touching * self.shear).sum((2, 3)) / part).norm(dim=1) * skin_radii
        usual = (depth < USUAL_DEPTH) & (drag < USUAL_DRAG)
        return (1 + 1.5 * usual) * (1 + 1.0 * ((depth > 0) & (drag < STILL)))


def maps_of(calibration: Calibration, parts: Sequence[Frames], name: str) -> Maps:
    """Prepare a twin's frames for a network."""
    fold, cells = network_size(name)
    way, by = WHOLE if name == WHOLE else HALVED, disc_map.CELLS // cells

    def pooled(array: np.ndarray) -> Tensor:
        values = torch.from_numpy(array)
        if by == 1:
            return values
        means = functional.avg_pool2d(values.float()[:, None], by)[:, 0]
        if values.dtype == torch.bool:
            return means >= 0.5
        return (means if values.is_floating_point() else means.round()).to(values.dtype)

    first = np.cumsum([0] + [len(part.reference[way]) for part in parts])
    geometry = disc_map.geometry_maps(calibration.geometry, calibration.pitch_px, cells)[
        :, ::fold, ::fold
    ]
    shear = [
        functional.avg_pool2d(torch.from_numpy(p.shear).float().permute(0, 3, 1, 2), 2)
        for p in parts
    ]
    return Maps(
        fold,
        torch.from_numpy(geometry).contiguous(),
        torch.cat([pooled(part.reference[way]) for part in parts]),
        torch.cat([pooled(part.white[way]) for part in parts]),
        torch.cat(
            [torch.from_numpy(part.sensor) + int(k) for part, k in zip(parts, first, strict=False)]
        ),
        torch.cat([pooled(part.height) for part in parts]),
        torch.cat([pooled(part.contact) for part in parts]),
        torch.cat(shear),
    )


def halved(device: str) -> torch.autocast:
    """Compute in bfloat16 where the device has it;
    a processor without it would take ten times as long.
    """
    kind = torch.device(device).type
    capable: dict[str, bool] = getattr(
        torch.cpu, "get_capabilities", dict
    )()  # older releases do not have it
    return torch.autocast(
        kind,
        torch.bfloat16,
        enabled=kind != "cpu" or any(map(capable.get, ("avx512_bf16", "amx_bf16"))),
    )


def train(
    network: TorchNetwork, maps: Maps, skin_radii: float, steps: int, report: Callable[[int], None]
) -> None:
    """Train a network; `report` receives the number of steps done.

    `skin_radii` as in `Maps.chances`.
    """
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, RATE, total_steps=steps, pct_start=WARM_PART
    )
    rng, draw = np.random.default_rng(0), torch.Generator().manual_seed(0)
    chances = maps.chances(skin_radii)
    for step in range(1, steps + 1):
        index = torch.multinomial(chances, BATCH, replacement=True, generator=draw)
        turn = 0 if rng.random() < OWN_PART else int(rng.integers(8))
        white, at_rest, height, contact, shear = maps.batch(index, turn)
        untrusted = spoil(white, at_rest, height, contact, TORN_PART, rng)
        optimiser.zero_grad(set_to_none=True)
        for some in torch.arange(BATCH).split(AT_ONCE):
            with halved("cpu"):
                made = network(*maps.inputs(white[some], at_rest[some]))
            true = (maps.fold, *(each[some] for each in (height, contact, shear, untrusted)))
            loss = depth_loss(made, *true)
            (loss * (len(some) / BATCH)).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        schedule.step()
        report(step)


def error(network: TorchNetwork, maps: Maps) -> float:
    """Mean error in contact of h, in disc radii."""
    errors = []
    for index in torch.arange(len(maps.white)).split(BATCH):
        white, at_rest, height, contact, _ = maps.batch(index, 0)
        with torch.no_grad():
            made, _ = network(*maps.inputs(white, at_rest))
        touching = (
            contact.flatten(1).sum(1) >= LEAST_CELLS * (len(contact[0]) / disc_map.CELLS) ** 2
        )
        off = (split_output(made, maps.fold)[0] - height).abs() * contact
        errors.append((off.flatten(1).sum(1) / contact.flatten(1).sum(1).clamp(min=1))[touching])
    return float(torch.cat(errors).mean()) / HEIGHT_SCALE
