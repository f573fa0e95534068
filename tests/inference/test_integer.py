"""The integer graphs against float64: what a layer makes of the codes that it is given, and all of a network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, unloaded
from support.networks import float_network, float_shear

from tacshade_edge.core.depth import Network, NetworkMaps
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import WEIGHTS, in_integers, load_network, runtime
from tacshade_edge.inference.onnx_weights import Node, joined, message, nodes_of, weights_of
from tacshade_edge.types import F32, F64, Frame

OF_DEPTH = [name for name, profile in PROFILES.items() if profile.network]
NAMES = [*OF_DEPTH, "shear"]
LAYER_BY_LAYER = [
    pytest.param(name, marks=pytest.mark.slow) if name in ("accurate", "shear") else name for name in NAMES
]
"""Every sum of a large network in float64 takes seconds."""
PRESSES = (("ball", 1.0), ("ball", 3.0), ("cube", 2.0), ("cross", 4.5))
MOST_WEIGHT = 63
ROUNDED_LSB = 1
"""Between exact sums and the runtime's codes."""
WEIGHTS_LSB = 10.0
"""What rounding the weights does to a layer's codes."""
MEAN_MM = 0.05
"""Of heights and of shears, between integers and float32."""
DISC_MM = 15.0
_GRAPH_OUTPUT, _NAME = 12, 1
Maps = TypeVar("Maps", NetworkMaps, F32)


@dataclass(frozen=True, slots=True)
class Layer:
    """A convolution of codes: what it was given and gave."""

    pad: int
    x: np.ndarray
    x_zero: int
    scaled: np.ndarray  # (O, C, k, k): the weights, not rounded, times the scales of the codes
    rounded: np.ndarray  # int8 (O, C, k, k)
    step: np.ndarray  # (O,) of the rounded weights
    bias: F64  # (O,) in steps, not rounded
    rounded_bias: np.ndarray  # int32 (O,), with what rounding the weights takes from the sums in the mean
    scale: np.ndarray  # (O,) that multiplies the sums
    zero: int
    codes: np.ndarray

    def sums(self, weights: np.ndarray) -> F64:
        """Of products with the codes, float64 (O, N, N), exact for integers."""
        size = weights.shape[-1]
        x = np.pad(self.x.astype(np.float64) - self.x_zero, ((0, 0), (self.pad,) * 2, (self.pad,) * 2))
        windows = np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
        found: F64 = np.tensordot(weights.astype(np.float64), windows, ((1, 2, 3), (0, 3, 4)))
        return found

    def exact(self) -> F64:
        """Its codes, from the rounded weights."""
        sums = self.sums(self.rounded) + self.rounded_bias[:, None, None]
        return np.clip(np.rint(sums * self.scale[:, None, None].astype(np.float64)) + self.zero, 0, 255)

    def unrounded(self) -> F64:
        """Its codes before rounding, from the weights as they are."""
        sums = self.sums(self.scaled) / self.step[:, None, None].astype(np.float64) + self.bias[:, None, None]
        return np.clip(sums * self.scale[:, None, None] + self.zero, 0, 255)


@cache
def inputs(name: str) -> tuple[tuple[F32, F32], ...]:
    """What a network is given for presses, and without one that of depth: white and the sensor's part."""
    of_depth = name if name in OF_DEPTH else "fast"
    network = load_network(of_depth)
    given: list[tuple[F32, F32]] = []

    def heard(run: Callable[[F32, F32], Maps]) -> Callable[[F32, F32], Maps]:
        def hear(white: F32, sensor: F32) -> Maps:
            given.append((white, sensor))
            return run(white, sensor)

        return hear

    if name in OF_DEPTH:
        network = replace(network, run=heard(network.run))
    else:
        shear = network.shear
        network = replace(network, shear=replace(shear, run=heard(shear.run)))
    reconstructor = Reconstructor(calibrated(), PROFILES[of_depth], network)
    for k, (shape, depth_mm) in enumerate(PRESSES):
        reconstructor.step(Frame(k, k, k, pressed(shape, depth_mm).image))
    reconstructor.step(Frame(9, 9, 9, unloaded()))
    assert len(given) >= len(PRESSES)
    return tuple(given)


@cache
def layers(name: str) -> tuple[Layer, ...]:
    """Every convolution of codes on every input."""
    path = WEIGHTS / f"{name}.onnx"
    data = in_integers(path, path.read_bytes())
    maker = {node.output: node for node in nodes_of(data)}
    convolutions = [node for node in maker.values() if node.kind == "QLinearConv"]
    wanted = {node.output: _tensors(node, maker) for node in convolutions}
    names = sorted({name for tensors in wanted.values() for name in tensors if name})
    shown = b"".join(message(_GRAPH_OUTPUT, message(_NAME, each.encode())) for each in names)
    session = runtime().InferenceSession(joined(data, shown), providers=["CPUExecutionProvider"])
    found = []
    for white, sensor in inputs(name):
        values = dict(zip(names, session.run(names, {"white": white[None], "sensor": sensor[None]}), strict=True))
        for node in convolutions:
            x, x_zero, scaled, rounded, step, bias, rounded_bias, scale, zero, codes = (
                values.get(each) for each in wanted[node.output]
            )
            pad = node.attributes["pads"]
            assert isinstance(pad, tuple)
            bias = np.zeros(len(rounded)) if bias is None else bias.astype(np.float64)
            given = (pad[0], x[0], int(x_zero), scaled, rounded, step.ravel(), bias, rounded_bias)
            found.append(Layer(*given, scale, int(zero), codes[0]))
    return tuple(found)


def _tensors(node: Node, maker: dict[str, Node]) -> tuple[str, ...]:
    """Names of a layer's tensors, in the order of `Layer`."""
    x, _, x_zero, rounded, scale, _, _, zero, rounded_bias = node.inputs
    divided = maker[maker[maker[rounded].inputs[0]].inputs[0]]
    assert divided.kind == "Div"
    given_back = maker[maker[maker[rounded_bias].inputs[0]].inputs[0]]
    bias = given_back.inputs[0] if given_back.kind == "Add" else ""
    return (x, x_zero, divided.inputs[0], rounded, divided.inputs[1], bias, rounded_bias, scale, zero, node.output)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYER_BY_LAYER)
def test_sums_are_exact_and_codes_rounded_once(name: str) -> None:
    off = max(float(np.abs(layer.codes - layer.exact()).max()) for layer in layers(name))
    assert off <= ROUNDED_LSB
    assert max(int(np.abs(layer.rounded.astype(int)).max()) for layer in layers(name)) == MOST_WEIGHT


@pytest.mark.parametrize("name", LAYER_BY_LAYER)
def test_rounded_weights_move_a_layer_by_a_few_codes(name: str) -> None:
    off = [np.abs(layer.codes - layer.unrounded()) for layer in layers(name)]
    worst, mean = max(float(each.max()) for each in off), max(float(each.mean()) for each in off)
    print(f"figure: {name} in integers: a layer's codes {worst:.1f} LSB off at most, {mean:.2f} in the mean")
    assert worst <= WEIGHTS_LSB
    assert mean <= 0.6


@pytest.mark.parametrize("name", LAYER_BY_LAYER)
def test_ranges_hold_what_a_press_makes(name: str) -> None:
    ends = [float((layer.codes == 255).mean()) for layer in layers(name)]
    assert max(ends) <= 1e-3


@pytest.mark.parametrize("name", OF_DEPTH)
def test_heights_are_those_of_float32(name: str, tmp_path: Path) -> None:
    exact, ours = float_network(name, tmp_path), load_network(name)
    off = [np.abs(heights_mm(ours, white, sensor) - heights_mm(exact, white, sensor)) for white, sensor in inputs(name)]
    mean, worst = max(float(each.mean()) for each in off), max(float(each.max()) for each in off)
    print(f"figure: {name} in integers: heights {mean:.3f} mm from float32 in a frame's mean, {worst:.2f} at most")
    assert mean <= MEAN_MM


def heights_mm(network: Network, white: F32, sensor: F32) -> F32:
    """Of a disc of 15 mm, all cells."""
    found: F32 = network.run(white, sensor).depth_and_contact[: network.fold**2] * np.float32(DISC_MM / 10)
    return found


def test_shears_are_those_of_float32(tmp_path: Path) -> None:
    exact, ours = float_shear(tmp_path), load_network("fast").shear
    off = [
        DISC_MM / 10 * np.abs(ours.run(white, sensor) - exact.run(white, sensor)) for white, sensor in inputs("shear")
    ]
    mean, worst = max(float(each.mean()) for each in off), max(float(each.max()) for each in off)
    print(f"figure: shear in integers: {mean:.3f} mm from float32 in a frame's mean, {worst:.2f} at most")
    assert mean <= MEAN_MM


@pytest.mark.parametrize("name", NAMES)
def test_the_integer_graph_brings_no_weights(name: str) -> None:
    assert weights_of((WEIGHTS / f"{name}.integer.onnx").read_bytes()) == []
