"""The integer graphs against float64: what a layer makes of the codes that it is given, and all of a network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, unloaded
from support.networks import float_network, float_shear

from tacshade_edge.core.depth import Network
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import WEIGHTS, in_integers, load_network, runtime
from tacshade_edge.inference.onnx_weights import joined, message, nodes_of
from tacshade_edge.types import F32, F64, Frame

OF_DEPTH = [name for name, profile in PROFILES.items() if profile.network]
NAMES = [*OF_DEPTH, "shear"]
LAYER_BY_LAYER = [
    pytest.param(name, marks=pytest.mark.slow) if name in ("accurate", "shear") else name
    for name in NAMES
]
"""Every sum of a large network in float64 takes seconds."""
PRESSES = (("ball", 1.0), ("ball", 3.0), ("cube", 2.0), ("cross", 4.5))
MOST_WEIGHT = 63
ROUNDED_LSB = 1
"""Between exact sums and the runtime's codes."""
MEAN_MM = 0.05
"""Of heights and of shears, between integers and float32."""
DISC_MM = 15.0
_GRAPH_OUTPUT, _NAME = 12, 1


@dataclass(frozen=True, slots=True)
class Layer:
    """A convolution of codes: what it was given and gave."""

    pad: int
    x: np.ndarray
    x_zero: int
    rounded: np.ndarray  # int8 (O, C, k, k)
    rounded_bias: (
        np.ndarray
    )  # int32 (O,), with what rounding the weights takes from the sums in the mean
    scale: np.ndarray  # (O,) that multiplies the sums
    zero: int
    codes: np.ndarray

    def exact(self) -> F64:
        """Its codes, from the rounded weights and sums in float64, which are exact for integers."""
        size = self.rounded.shape[-1]
        x = np.pad(
            self.x.astype(np.float64) - self.x_zero, ((0, 0), (self.pad,) * 2, (self.pad,) * 2)
        )
        windows = np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
        sums = np.tensordot(self.rounded.astype(np.float64), windows, ((1, 2, 3), (0, 3, 4)))
        sums += self.rounded_bias[:, None, None]
        return np.asarray(
            np.clip(
                np.rint(sums * self.scale[:, None, None].astype(np.float64)) + self.zero, 0, 255
            )
        )


@cache
def inputs(name: str) -> tuple[tuple[F32, F32], ...]:
    """What a network is given for presses, and without one that of depth: white and the sensor's part."""
    of_depth = name if name in OF_DEPTH else "fast"
    network = load_network(of_depth)
    given: list[tuple[F32, F32]] = []

    def heard(part: Network) -> Network:
        def hear(white: F32, sensor: F32, _: object) -> Sequence[F32]:
            given.append((white, sensor))
            return part.run(white, sensor)

        return replace(part, run=hear)

    assert network.shear is not None
    network = heard(network) if name in OF_DEPTH else replace(network, shear=heard(network.shear))
    reconstructor = Reconstructor(calibrated(), PROFILES[of_depth], network)
    for k, (shape, depth_mm) in enumerate(PRESSES):
        reconstructor.step(Frame(k, k, k, pressed(shape, depth_mm).image))
    reconstructor.step(Frame(9, 9, 9, unloaded()))
    assert len(given) >= len(PRESSES)
    return tuple(given)


def layers(name: str) -> Iterator[Layer]:
    """Every convolution of codes on every input."""
    path = WEIGHTS / f"{name}.onnx"
    data = in_integers(path, path.read_bytes())
    convolutions = [node for node in nodes_of(data) if node.kind == "QLinearConv"]
    # x, its zero, weights, the outputs' scale and zero, bias, and the codes.
    wanted = [(*(node.inputs[k] for k in (0, 2, 3, 4, 7, 8)), node.output) for node in convolutions]
    names = sorted({each for tensors in wanted for each in tensors})
    shown = b"".join(message(_GRAPH_OUTPUT, message(_NAME, each.encode())) for each in names)
    session = runtime().InferenceSession(joined(data, shown), providers=["CPUExecutionProvider"])
    for white, sensor in inputs(name):
        values = dict(
            zip(
                names,
                session.run(names, {"white": white[None], "sensor": sensor[None]}),
                strict=True,
            )
        )
        for node, tensors in zip(convolutions, wanted, strict=True):
            x, x_zero, rounded, scale, zero, bias, codes = (values[each] for each in tensors)
            pad = node.attributes["pads"]
            assert isinstance(pad, tuple)
            yield Layer(pad[0], x[0], int(x_zero), rounded, bias, scale, int(zero), codes[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYER_BY_LAYER)
def test_sums_are_exact_and_codes_rounded_once(name: str) -> None:
    for layer in layers(name):
        assert np.abs(layer.codes - layer.exact()).max() <= ROUNDED_LSB
        assert np.abs(layer.rounded.astype(int)).max() <= MOST_WEIGHT
        assert np.mean(layer.codes == 255) <= 1e-3  # their range holds what a press makes


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_DEPTH)
def test_heights_are_those_of_float32(name: str, tmp_path: Path) -> None:
    exact, ours = float_network(name, tmp_path), load_network(name)
    off = [
        np.abs(heights_mm(ours, white, sensor) - heights_mm(exact, white, sensor))
        for white, sensor in inputs(name)
    ]
    mean, worst = max(float(each.mean()) for each in off), max(float(each.max()) for each in off)
    print(
        f"figure: {name} in integers: heights {mean:.3f} mm from float32 in a frame's mean, {worst:.2f} at most"
    )
    assert mean <= MEAN_MM


def heights_mm(network: Network, white: F32, sensor: F32) -> F32:
    """Of a disc of 15 mm, all cells."""
    found: F32 = network.run(white, sensor)[0][: network.fold**2] * np.float32(DISC_MM / 10)
    return found


@pytest.mark.slow
def test_shears_are_those_of_float32(tmp_path: Path) -> None:
    exact, ours = float_shear(tmp_path), load_network("fast").shear
    assert ours is not None
    off = [
        DISC_MM / 10 * np.abs(ours.run(white, sensor)[0] - exact.run(white, sensor)[0])
        for white, sensor in inputs("shear")
    ]
    mean, worst = max(float(each.mean()) for each in off), max(float(each.max()) for each in off)
    print(
        f"figure: shear in integers: {mean:.3f} mm from float32 in a frame's mean, {worst:.2f} at most"
    )
    assert mean <= MEAN_MM
