"""Give some of the sensors other looks, and their frames fresh disturbances."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

LOOKS_PART = 0.3
"""Share of the frames that get another look."""
GAMMA, BLUR, GAIN, NOISE = 0.25, 0.2, 0.03, 0.02
"""Deviation of the logarithm of a sensor's gamma, greatest share that a cell takes from each neighbour, deviation of a
frame's gain, and greatest deviation of its noise (white is 0 to 1)."""


def other_looks(maps: Tensor, generator: torch.Generator) -> Tensor:
    """Change the white of frames and references, (B, 2, cells, cells), 0 to 1.

    Dots that are thresholded larger or smaller (gamma) or seen less sharply (blur) are another sensor's, so frame and
    reference change alike. Gain and noise change only the frame.
    """

    def drawn(normal: bool) -> Tensor:
        draw = torch.randn if normal else torch.rand
        return draw((len(maps), 1, 1, 1), generator=generator, device=maps.device)

    changed = maps.clamp(min=1e-4) ** (GAMMA * drawn(True)).exp()
    blur = BLUR * drawn(False)
    for dim in (2, 3):
        pad = (1, 1, 0, 0) if dim == 3 else (0, 0, 1, 1)
        wide, cells = functional.pad(changed, pad, mode="replicate"), maps.shape[dim]
        changed = changed + blur * (wide.narrow(dim, 0, cells) + wide.narrow(dim, 2, cells) - 2 * changed)
    shown = (maps > 0).any(1, keepdim=True)  # nothing shows outside the disc
    noise = torch.randn(maps[:, :1].shape, generator=generator, device=maps.device)
    frame = changed[:, :1] * (1 + GAIN * drawn(True)) + NOISE * drawn(False) * noise
    changed = torch.cat((frame, changed[:, 1:]), 1).clamp(0, 1) * shown
    return torch.where(drawn(False) < LOOKS_PART, changed, maps)
