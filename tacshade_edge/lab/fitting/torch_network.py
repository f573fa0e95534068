"""A shipped network as PyTorch trains it: the operations of its graph, and its weights."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from tacshade_edge.sensor.inference.network import network_files
from tacshade_edge.sensor.inference.onnx_weights import nodes_of, values_of, weights_of
from tacshade_edge.types import F32

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
        # A graph that was exported by a later tool would otherwise train into something else.
        if unknown := {node.kind for node in self._nodes} - set(OPERATIONS):
            raise ValueError(f"operations {', '.join(sorted(unknown))} are not known here")
        self._weights: dict[str, Tensor] = {}
        for prefix, data in (("", frame), (_ONCE, once)):
            values, at = torch.from_numpy(values_of(data)), 0
            # As the files list them: `flat` and a calibration keep the same order.
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
        what is known of each frame's sensor (`sensor.depth.learned.known_maps`).
        """
        # What depends on the sensor alone is computed once by the daemon, and here for every frame,
        # because it is trained too.
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
