"""The part of a network's first layer that a sensor fixes, computed once in exact sums (docs:
numerics).
"""

from __future__ import annotations

import numpy as np

from tacshade_edge.sensor.inference.onnx_weights import weights_of
from tacshade_edge.types import F32, F64

KNOWN_BITS, WEIGHT_BITS = 14, 20
"""Bits behind the point of what is known of the sensor, and of the weights: the sums of their
products are exact in float64 below 2**19, whatever adds them, and how.
"""
RESULT_BITS = 10
"""Bits behind the point of the result, which float32 adds exactly to what the graph makes
of white.
"""


def sensor_layer(data: bytes, known: F32) -> F32:
    """The convolution in a file ``NAME.sensor.onnx`` of maps (C, N, N): float32 (channels, N, N).

    Zeros surround the maps, so that the result has their size.
    """
    weight, bias = (
        np.frombuffer(data[one.begin : one.end], "<f4").reshape(one.shape)
        for one in weights_of(data)
    )
    channels, _, size, _ = weight.shape
    pad = size // 2
    rows, cols = known.shape[1:]
    # By powers of two, which change no digit but the point's place.
    around = np.pad(_whole(known, KNOWN_BITS), ((0, 0), (pad, pad), (pad, pad)))
    steps = _whole(weight, WEIGHT_BITS)
    sums = np.repeat(_whole(bias, KNOWN_BITS + WEIGHT_BITS)[:, None], rows * cols, axis=1)
    # A product of matrices for each place of the kernel. BLAS may add in any order: the sums are
    # exact.
    for row, col in np.ndindex(size, size):
        moved = around[:, row : row + rows, col : col + cols]
        sums += steps[:, :, row, col] @ moved.reshape(len(known), -1)
    coarse = np.rint(np.ldexp(sums, RESULT_BITS - KNOWN_BITS - WEIGHT_BITS))
    return np.ldexp(coarse, -RESULT_BITS).astype(np.float32).reshape(channels, rows, cols)


def _whole(values: F32, bits: int) -> F64:
    """Multiples of 2**-bits, rounded to even where two are as near."""
    return np.rint(np.ldexp(values.astype(np.float64), bits))
