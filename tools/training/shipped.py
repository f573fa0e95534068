"""Load the shipped weights for further training: frames restore the batch normalisation, which export had folded."""

from __future__ import annotations

from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from tools.training.network import Net, ShearNet

WEIGHTS = Path(__file__).parents[2] / "tacshade_edge" / "inference" / "weights"


def shipped(net: Net | ShearNet, name: str, inputs: list[Tensor]) -> None:
    """Give a network the shipped weights, so that it computes the same as the shipped network.

    The inputs are frames as it takes them, which determine each normalisation's mean and variance.
    """
    frame, sensor = (_tensors(WEIGHTS / f"{name}{end}") for end in (".onnx", ".sensor.onnx"))
    named = {key.removeprefix("rest."): frame.pop(key) for key in list(frame) if key.startswith("rest.")}
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
    """Set a normalisation's statistics to those of its convolution's output, and its scale and shift to undo them."""
    seen: list[Tensor] = []
    hook = conv.register_forward_hook(lambda _module, _given, made: seen.append(made.transpose(0, 1).flatten(1)))
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
        each.name: torch.from_numpy(numpy_helper.to_array(each).copy()) for each in onnx.load(path).graph.initializer
    }
