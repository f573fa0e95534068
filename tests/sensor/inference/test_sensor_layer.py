"""The first layer's part of the sensor: the runtime's within its rounding, and exact sums."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.sensor.inference.network import network_files, runtime
from tacshade_edge.sensor.inference.onnx_weights import weights_of, with_values
from tacshade_edge.sensor.inference.sensor_layer import RESULT_BITS, sensor_layer
from tacshade_edge.types import F32

NAMES = ("fast", "balanced", "accurate", "shear")
ROUNDED = 0.75 * 2**-RESULT_BITS
"""Half a step of the result, and a quarter for what is known in coarser steps."""


def known_of(data: bytes) -> F32:
    """Values as large as what is known of a sensor."""
    channels = weights_of(data)[0].shape[1]
    return np.random.default_rng(3).uniform(-2, 2, (channels, 28, 28)).astype(np.float32)


@pytest.mark.parametrize("name", NAMES)
def test_the_layer_is_the_files_convolution(name: str) -> None:
    data = network_files(name)[1]
    session = runtime().InferenceSession(data, providers=["CPUExecutionProvider"])
    side = session.get_inputs()[0].shape[-1]
    known = known_of(data)[:, :side, :side]
    known = np.pad(known, ((0, 0), *[(0, side - known.shape[-1])] * 2))
    found = sensor_layer(data, known)
    expected = session.run(None, {"known": known[None]})[0][0]
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDED)
    steps = np.ldexp(found, RESULT_BITS)
    np.testing.assert_array_equal(steps, np.rint(steps))


@pytest.mark.parametrize("name", NAMES)
def test_sums_do_not_depend_on_their_order(name: str) -> None:
    data = network_files(name)[1]
    known, order = known_of(data), np.random.default_rng(5).permutation(len(known_of(data)))
    weight, bias = weights_of(data)
    values = np.frombuffer(data[weight.begin : weight.end], "<f4").reshape(weight.shape)
    turned = values[:, order].ravel(), np.frombuffer(data[bias.begin : bias.end], "<f4")
    other = sensor_layer(with_values(data, np.concatenate(turned)), known[order])
    np.testing.assert_array_equal(other, sensor_layer(data, known))
