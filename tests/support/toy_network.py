"""Networks that are functions written down."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tacshade_edge.core.depth import Network, NetworkMaps, ShearNetwork
from tacshade_edge.types import F32

ALL_TRUSTED = np.full((28, 28), -9, np.float32)


def displaced(white: F32, sensor: F32) -> F32:
    """0.3 tenths of the disc's radius along x, NaN at one cell."""
    shear = np.stack((np.full((28, 28), 0.3, np.float32), np.zeros((28, 28), np.float32)))
    shear[0, 14, 14] = np.nan
    return shear


DISPLACED = ShearNetwork(4, 112, lambda known: known, displaced)


def answering(fold: int, sense: Callable[[F32], F32], run: Callable[[F32, F32], F32]) -> Network:
    """Make one of a function of its own; every cell is trusted, and the skin is `displaced`."""
    return Network(fold, sense, lambda white, sensor: NetworkMaps(run(white, sensor), ALL_TRUSTED), DISPLACED)


def saying(depth_and_contact: F32, untrusted: F32 = ALL_TRUSTED) -> Network:
    """Make one of 4x4 folded maps that says the same of every frame; the skin is `displaced`."""
    maps = NetworkMaps(depth_and_contact, untrusted)
    return Network(4, lambda known: known, lambda white, sensor: maps, DISPLACED)
