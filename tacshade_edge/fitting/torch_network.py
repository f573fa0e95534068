"""A shipped network as a fit changes it, built from its ONNX file so that the network has only one definition."""

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
    """The network that runs for every frame, with a scale and a bias for each output channel of its convolutions.

    A sensor's code of 520 to 1378 numbers: presses of a few shapes can hardly teach these anything but the sensor,
    while all weights would learn the shapes, too (decision 8; E. Perez et al., "FiLM", AAAI 2018).

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
        self._scale_heights(height_factor)
        self._scales = {
            name: torch.ones(len(weight), 1, 1, 1) for name, weight in self._weights.items() if weight.dim() == 4
        }
        for each in self.parameters():
            each.requires_grad_()

    def parameters(self) -> list[Tensor]:
        """The tensors that training changes."""
        return [*self._scales.values(), *(each for each in self._weights.values() if each.dim() == 1)]

    def __call__(self, white: Tensor, sensor: Tensor) -> tuple[Tensor, Tensor]:
        """Run frames to depth and contact (B, 2 fold², N, N) and untrusted log odds (B, 1, M, M).

        Parameters
        ----------
        white : Tensor float32 (B, fold², N, N)
        sensor : Tensor float32 (1 or B, channels, N, N)
            What the sensor of all frames, or of each, adds to the first layer.
        """
        values = self._scaled() | {"white": white, "sensor": sensor}
        for node in self._nodes:
            given = [values[name] for name in node.inputs if name in values]
            values[node.output] = OPERATIONS[node.kind](node.attributes, given)
        return values["depth_and_contact"], values["foreign"]

    def flat(self) -> F32:
        """All weights end to end, in the order of `onnx_weights.values_of`."""
        flat: F32 = torch.cat([weight.detach().flatten() for weight in self._scaled().values()]).numpy()
        return flat

    def _scaled(self) -> dict[str, Tensor]:
        return {
            name: weight * self._scales[name] if name in self._scales else weight
            for name, weight in self._weights.items()
        }

    def _scale_heights(self, factor: float) -> None:
        """Multiply the half of the head that predicts h."""
        head: Node = next(node for node in self._nodes if node.output == "depth_and_contact")
        for name in head.inputs[1:]:
            weight = self._weights[name]
            weight[: len(weight) // 2] *= factor
