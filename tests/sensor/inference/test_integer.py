"""The integer graphs against whole numbers and float64, and against the float32 networks."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from support.calibrated_sensor import calibrated, pressed, unloaded
from support.integer_codes import NAMES, Integers, crc32, given
from support.networks import float_network, float_shear
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.inference.network import load_network
from tacshade_edge.sensor.inference.onnx_weights import Node
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, F64, Frame

GOLDEN = Path(__file__).parents[2] / "golden" / "integers.json"
OF_DEPTH = [name for name, profile in PROFILES.items() if profile.network]
PRESSES = (("ball", 1.0), ("ball", 3.0), ("cube", 2.0), ("cross", 4.5))
MOST_WEIGHT = 63
MOST_SUM = 64.0
"""First layers' sums are exact below."""
WHITE = 255
MEAN_MM, WORST_MM = 0.05, 0.15
"""Of heights and of shears, between integers and float32: in a frame's mean, and of any cell."""
EXACT_MM = 5e-5
"""Of heights and of shears, between the runtime and float64 for the same codes."""
DISC_MM = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """An integer graph, and its tensors for an image."""

    makers: Mapping[str, Node]
    sensor: F32
    of: Mapping[str, np.ndarray]

    def expected(self, node: Node) -> F64:
        """The codes that a node should make of those that it is given."""
        if node.kind == "QLinearConv":
            return self._convolution(node)
        scale, zero = (self.of[name] for name in node.inputs[1:])
        source = self.makers[node.inputs[0]]
        if source.kind == "Add":
            terms = (self.makers[name] for name in source.inputs)
            return coded(sum(map(self._value, terms), np.zeros(())) / float(scale), int(zero))
        exact = np.maximum(self._first_layer(), 0).astype(np.float32)
        return coded(exact / scale, int(zero))  # the one float32 that is rounded

    def _convolution(self, node: Node) -> F64:
        """Sums of whole numbers; their product with the scale is the one float32
        that is rounded.
        """
        given = (self.of[node.inputs[k]] for k in (0, 2, 3, 4, 7, 8))
        x, x_zero, weight, scale, zero, bias = given
        sums = convolved(x[0].astype(np.float64) - int(x_zero), weight, node)
        sums += bias[:, None, None]
        assert np.abs(weight.astype(int)).max() <= MOST_WEIGHT
        return coded(sums.astype(np.float32) * scale[:, None, None], int(zero))[None]

    def _value(self, node: Node) -> F64:
        """The values of codes."""
        x, scale, zero = (self.of[name] for name in node.inputs)
        return np.asarray((x.astype(np.float64) - int(zero)) * float(scale))

    def _first_layer(self) -> F64:
        """What white's codes and the sensor make, before the ReLU."""
        node = next(node for node in self.makers.values() if node.inputs[:1] == ("white_values",))
        weight = self.of[node.inputs[1]]
        reach = WHITE * np.abs(weight).sum(axis=(1, 2, 3)).max() + np.abs(self.sensor).max()
        assert reach < MOST_SUM
        return convolved(self.of["white_codes"][0], weight, node)[None] + self.sensor

    def exact(self, name: str) -> F64:
        """A tensor of the layers in float32, in float64 from their codes."""
        node = self.makers[name]
        if node.kind == "Cast":
            return np.asarray(self.of[node.inputs[0]][0], np.float64)
        x = self.exact(node.inputs[0])
        if node.kind == "Relu":
            return np.maximum(x, 0)
        weight, *bias = (self.of[name] for name in node.inputs[1:])
        return convolved(x, weight, node) + (bias[0][:, None, None] if bias else 0)


def convolved(x: np.ndarray, weight: np.ndarray, node: Node) -> F64:
    """The sums of a convolution without a stride, in float64, which are exact for codes."""
    pads, size = node.attributes["pads"], weight.shape[-1]
    assert isinstance(pads, tuple)
    around = np.pad(x.astype(np.float64), ((0, 0), (pads[0],) * 2, (pads[0],) * 2))
    windows = np.lib.stride_tricks.sliding_window_view(around, (size, size), axis=(1, 2))
    return np.tensordot(weight.astype(np.float64), windows, ((1, 2, 3), (0, 3, 4)))


def coded(values: np.ndarray, zero: int) -> F64:
    """Rounded half to even, then clipped."""
    return np.clip(np.rint(values).astype(np.float64) + zero, 0, 255)


@cache
def inputs(name: str) -> tuple[tuple[F32, F32], ...]:
    """What a network is given for presses, and without one that of depth:
    white and the sensor's part.
    """
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


def seen(name: str, images: Sequence[tuple[F32, F32]]) -> Iterator[Seen]:
    """Every image."""
    network = Integers.shipped(name)
    makers = {node.output: node for node in network.nodes}
    kinds = ("QLinearConv", "QuantizeLinear", "DequantizeLinear", "Conv")
    nodes = [node for node in network.nodes if node.kind in kinds]
    every = {each for node in nodes for each in (*node.inputs, node.output)}
    found = network.run(sorted(every - {"white", "sensor"}), images)
    for (_, sensor), tensors in zip(images, found, strict=True):
        yield Seen(makers, sensor, tensors)


def codes_of(one: Seen) -> Iterator[tuple[Node, np.ndarray]]:
    """The nodes that make codes of codes, and what they made."""
    for node in one.makers.values():
        if node.kind in ("QLinearConv", "QuantizeLinear") and node.output != "white_codes":
            yield node, one.of[node.output]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_codes_are_exact(name: str) -> None:
    """Five sensors, at rest, pressed, and of noise, black, white and both."""
    for (white, _), one in zip(given(name), seen(name, given(name)), strict=True):
        expected = np.rint(white.astype(np.float64) * WHITE)
        np.testing.assert_array_equal(one.of["white_codes"][0], expected)
        for node, codes in codes_of(one):
            np.testing.assert_array_equal(codes, one.expected(node), err_msg=node.output)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_layers_in_float32_are_those_of_float64(name: str) -> None:
    output, channels = ("displacement", 2) if name == "shear" else ("depth_and_contact", None)
    if channels is None:
        channels = load_network(name).fold ** 2
    for one in seen(name, given(name)):
        off = np.abs(one.of[output][0] - one.exact(output))[:channels]
        assert DISC_MM / 10 * off.max() <= EXACT_MM


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_codes_hold_what_a_press_makes(name: str) -> None:
    for one in seen(name, inputs(name)):
        for node, codes in codes_of(one):
            assert np.mean(codes == 255) <= 1e-3, node.output
            np.testing.assert_array_equal(codes, one.expected(node), err_msg=node.output)


@pytest.mark.parametrize("name", NAMES)
def test_every_processor_makes_these_codes(name: str) -> None:
    """`make test-arm` runs it on a board's processor.

    The golden file changes with the weights alone: ``.venv/bin/python -m
    support.integer_codes > tests/golden/integers.json``.
    """
    assert f"{crc32(name):08x}" == json.loads(GOLDEN.read_text())[name]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("qemu-x86_64") is None, reason="needs Debian's qemu-user")
@pytest.mark.parametrize("processor", ["Haswell", "Nehalem"])
def test_processors_without_vnni_make_these_codes(processor: str) -> None:
    """With AVX2, and with SSE 4.2 alone: there the runtime adds products in int16."""
    command = ("qemu-x86_64", "-cpu", processor, sys.executable, "-m", "support.integer_codes")
    # A kernel that the machine chose for its own processor is none of the emulated one's.
    inherited = {key: text for key, text in os.environ.items() if not key.startswith("OPENBLAS_")}
    environment = inherited | {"PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == json.loads(GOLDEN.read_text())


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
        f"figure: {name} in integers: heights {mean:.3f} mm from float32 in a frame's mean, "
        f"{worst:.2f} at most"
    )
    assert mean <= MEAN_MM
    assert worst <= WORST_MM


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
        f"figure: shear in integers: {mean:.3f} mm from float32 in a frame's mean, "
        f"{worst:.2f} at most"
    )
    assert mean <= MEAN_MM
    assert worst <= WORST_MM
