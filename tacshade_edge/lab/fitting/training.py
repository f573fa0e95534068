"""Train a shipped network on a twin's frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tacshade_edge.lab.fitting.losses import COARSE_CELLS, depth_loss, split_output
from tacshade_edge.lab.fitting.spoilt_frames import spoil
from tacshade_edge.lab.fitting.torch_network import TorchNetwork
from tacshade_edge.lab.fitting.twin import HALVED, WHOLE, Frames
from tacshade_edge.sensor.depth.learned import HEIGHT_SCALE
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.inference.network import network_size
from tacshade_edge.types import Calibration

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
        # A quarter turn of rows and columns maps x to -y and y to x.
        for _ in range(turn % 4):
            shear = torch.stack((shear[:, 1], -shear[:, 0]), 1)
        if turn >= 4:
            shear = shear * shear.new_tensor((-1, 1))[:, None, None]
        return tuple(each.contiguous() for each in (white, at_rest, height, contact, shear))

    def inputs(self, white: Tensor, at_rest: Tensor) -> tuple[Tensor, Tensor]:
        """The network's inputs."""
        known = self.known.expand(len(white), -1, -1, -1)
        known = torch.cat((functional.pixel_unshuffle(at_rest[:, None], self.fold), known), 1)
        # Channels last: 1.4 to 2.4 times as fast on a processor.
        last = torch.channels_last
        white = functional.pixel_unshuffle(white[:, None], self.fold)
        return white.contiguous(memory_format=last), known.contiguous(memory_format=last)

    def chances(self, skin_radii: float) -> Tensor:
        """Weight each frame for drawing: presses like those of users come more often.

        `skin_radii`: of the disc.
        """
        depth = self.height.flatten(1).amax(1).float() * skin_radii
        touching = functional.adaptive_avg_pool2d(self.contact[:, None].float(), COARSE_CELLS)
        # Without contact there is no mean; any small number gives 0.
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
            # A cell touches if most of it does.
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
    # Older releases of PyTorch do not have it.
    capable: dict[str, bool] = getattr(torch.cpu, "get_capabilities", dict)()
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
    # Two streams: torch draws the frames, numpy what is done to them; both from fixed seeds, so
    # that a fit can be repeated.
    rng, draw = np.random.default_rng(0), torch.Generator().manual_seed(0)
    chances = maps.chances(skin_radii)
    for step in range(1, steps + 1):
        index = torch.multinomial(chances, BATCH, replacement=True, generator=draw)
        # A lattice turned by a quarter is another one: networks learn more from it, yet must know
        # this.
        turn = 0 if rng.random() < OWN_PART else int(rng.integers(8))
        white, at_rest, height, contact, shear = maps.batch(index, turn)
        untrusted = spoil(white, at_rest, height, contact, TORN_PART, rng)
        optimiser.zero_grad(set_to_none=True)
        # Sums of parts are the gradient of the batch.
        for some in torch.arange(BATCH).split(AT_ONCE):
            with halved("cpu"):
                made = network(*maps.inputs(white[some], at_rest[some]))
            true = (maps.fold, *(each[some] for each in (height, contact, shear, untrusted)))
            loss = depth_loss(made, *true)
            (loss * (len(some) / BATCH)).backward()
        # One frame that is torn in a new way must not undo many steps.
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
