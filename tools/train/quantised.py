"""Training that knows of 8 bits: convolutions round their inputs and weights as an integer network will.

Weights are symmetric, one scale for each output channel: a batch normalisation that is folded in later multiplies whole
channels and changes nothing. Inputs have one affine range for each layer, a running mean of what batches reach. The
gradient goes straight through the rounding (Jacob et al., CVPR 2018).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

MOMENTUM = 0.01


class QuantisedConv2d(nn.Conv2d):
    """A convolution of 8-bit inputs and weights, computed in floating point."""

    seen: tuple[float, float] | None
    """Least and greatest input, as a running mean over batches."""

    def forward(self, x: Tensor) -> Tensor:
        """Run it."""
        if self.training or self.seen is None:
            new = min(float(x.detach().amin()), 0.0), max(float(x.detach().amax()), 1e-6)
            old = self.seen or new
            self.seen = old[0] + MOMENTUM * (new[0] - old[0]), old[1] + MOMENTUM * (new[1] - old[1])
        low, high = self.seen
        scale = (high - low) / 255
        zero = round(-low / scale)
        x = torch.fake_quantize_per_tensor_affine(x.float(), scale, zero, 0, 255)
        most = self.weight.detach().abs().amax((1, 2, 3)).clamp(min=1e-9).float() / 127
        none = torch.zeros_like(most, dtype=torch.int32)
        weight = torch.fake_quantize_per_channel_affine(self.weight.float(), most, none, 0, -127, 127)
        return functional.conv2d(x, weight, self.bias, self.stride, self.padding)


def quantise(net: nn.Module) -> None:
    """Make every convolution of a network a quantised one, in place; its weights keep their names."""
    for module in net.modules():
        if type(module) is nn.Conv2d:
            module.__class__ = QuantisedConv2d
            module.seen = None
