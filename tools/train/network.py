"""The network: a small U; 112x112 maps go in and out folded: 4 channels of 56x56 (fold 2) or 16 of 28x28 (fold 4)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

HEIGHT_SCALE = 10.0
"""The network's h is in tenths of the disc's radius: about 0 to 4."""

KNOWN = 6
"""Maps of `discmap.geometry_maps`."""


def block(inputs: int, outputs: int) -> nn.Sequential:
    """Two 3x3 convolutions."""
    layers: list[nn.Module] = []
    for channels in (inputs, outputs):
        layers += [
            nn.Conv2d(channels, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        ]
    return nn.Sequential(*layers)


class Net(nn.Module):
    """Folded maps (B, 2 fold² + 6, N, N) to (B, 2 fold², N, N), N = 112 / fold.

    In: white of frame and reference, then what is known of the sensor. Out: 10 h / disc radius, then contact logits.
    """

    def __init__(self, fold: int = 2, widths: tuple[int, ...] = (16, 32, 48, 64)) -> None:
        super().__init__()
        inputs = 2 * fold * fold + KNOWN
        self.fold = fold
        self.down = nn.ModuleList(block(i, o) for i, o in zip((inputs, *widths[:-1]), widths, strict=True))
        self.up = nn.ModuleList(block(a + b, a) for a, b in pairwise(widths))
        self.head = nn.Conv2d(widths[0], 2 * fold * fold, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Run it."""
        skips = []
        for k, layer in enumerate(self.down):
            x = layer(x if k == 0 else functional.max_pool2d(x, 2))
            skips.append(x)
        for k in reversed(range(len(self.up))):
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = self.up[k](torch.cat((skips[k], x), 1))
        return self.head(x)
