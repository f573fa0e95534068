"""A shipped network as PyTorch trains it, built from its ONNX file so that the network has only one definition."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tacshade_edge.inference.onnx_weights import Node, nodes_of, values_of, weights_of
from tacshade_edge.types import F32

Operation = Callable[[dict[str, Any], list[Tensor]], Tensor]


def _convolution(attributes: dict[str, Any], given: list[Tensor]) -> Tensor:
    x, weight = given[:2]
    bias = given[2] if len(given) > 2 else None
    return functional.conv2d(x, weight, bias, padding=attributes["pads"][0])


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
    "DepthToSpace": lambda attributes, given: functional.pixel_shuffle(given[0], attributes["blocksize"]),
}
"""The operations in the graphs that tools/training/export.py writes."""


class TorchNetwork:
    """The network that runs for every frame, and a correction to what the sensor adds to its first layer.

    Parameters
    ----------
    onnx : bytes
        The shipped file.
    sensors : sequence of float32 (channels, N, N)
        What the sensor adds to the first layer, then what its other views would add (`press_targets.VIEWS`).
    height_factor : float
        Multiplies the network's heights before the training.

    Raises
    ------
    ValueError
        The file has an operation that is not in `OPERATIONS`.
    """

    def __init__(self, onnx: bytes, sensors: Sequence[F32], height_factor: float) -> None:
        self._nodes = [node for node in nodes_of(onnx) if node.kind != "Constant"]
        if unknown := {node.kind for node in self._nodes} - set(OPERATIONS):
            raise ValueError(f"operations {', '.join(sorted(unknown))} are not known here")
        values, at = torch.from_numpy(values_of(onnx)), 0
        self._weights: dict[str, Tensor] = {}
        for weight in weights_of(onnx):
            size = (weight.end - weight.begin) // 4
            self._weights[weight.name] = values[at : at + size].reshape(weight.shape).clone()
            at += size
        self.sensors = torch.from_numpy(np.stack(sensors))[:, None]
        self.correction = torch.zeros_like(self.sensors[0])
        self._scale_heights(height_factor)
        for each in self.parameters():
            each.requires_grad_()

    def parameters(self) -> list[Tensor]:
        """The tensors that training changes."""
        return [*self._weights.values(), self.correction]

    def copy(self) -> list[Tensor]:
        """A copy of `parameters` as they are now."""
        return [each.detach().clone() for each in self.parameters()]

    def restore(self, copied: Sequence[Tensor]) -> None:
        """Set `parameters` to copied values."""
        with torch.no_grad():
            for each, was in zip(self.parameters(), copied, strict=True):
                each.copy_(was)

    def __call__(self, white: Tensor, view: int = 0) -> tuple[Tensor, Tensor]:
        """Run frames (B, fold², N, N) to depth and contact (B, 2 fold², N, N) and untrusted log odds (B, 1, M, M).

        `view` is the sensor's index in `sensors`; the correction applies only to the first.
        """
        values: dict[str, Tensor] = dict(self._weights)
        values |= {"white": white, "sensor": self.sensors[view] + (0 if view else self.correction)}
        for node in self._nodes:
            given = [values[name] for name in node.inputs if name in values]
            values[node.output] = OPERATIONS[node.kind](node.attributes, given)
        return values["depth_and_contact"], values["foreign"]

    def flat(self) -> F32:
        """All weights end to end, in the order of `onnx_weights.values_of`."""
        flat: F32 = torch.cat([weight.detach().flatten() for weight in self._weights.values()]).numpy()
        return flat

    def _scale_heights(self, factor: float) -> None:
        """Multiply the half of the head that predicts h."""
        head: Node = next(node for node in self._nodes if node.output == "depth_and_contact")
        for name in head.inputs[1:]:
            weight = self._weights[name]
            weight[: len(weight) // 2] *= factor
