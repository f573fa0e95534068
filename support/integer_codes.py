"""The codes of the integer graphs on sensors and images of extremes, which are the same everywhere.

As a program, it prints the CRC-32 of each network's codes as JSON,
as tests/golden/integers.json has them.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.sensor.depth.learned import fold, known_maps
from tacshade_edge.sensor.inference.network import (
    WEIGHTS,
    in_integers,
    load_network,
    read_part,
    runtime,
)
from tacshade_edge.sensor.inference.onnx_weights import Node, joined, message, nodes_of
from tacshade_edge.types import F32

NAMES = ("fast", "balanced", "accurate", "shear")
SENSORS = (None, 5, 11, 21, 31)
"""Seeds of simulated sensors; None: the default one."""
CODED = ("QLinearConv", "QuantizeLinear")
_GRAPH_OUTPUT, _NAME = 12, 1


@dataclass(frozen=True, slots=True)
class Integers:
    """A network whose inner tensors can be seen."""

    name: str
    data: bytes
    nodes: Sequence[Node]

    @classmethod
    def shipped(cls, name: str) -> Integers:
        path = WEIGHTS / f"{name}.onnx"
        data = in_integers(path, path.read_bytes())
        return cls(name, data, nodes_of(data))

    def run(
        self, names: Sequence[str], given: Sequence[tuple[F32, F32]]
    ) -> Iterator[dict[str, np.ndarray]]:
        """Tensors of each image."""
        shown = b"".join(message(_GRAPH_OUTPUT, message(_NAME, each.encode())) for each in names)
        options = runtime().SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3  # it warns about unknown processors
        session = runtime().InferenceSession(
            joined(self.data, shown), options, providers=["CPUExecutionProvider"]
        )
        for white, sensor in given:
            found = session.run(names, {"white": white[None], "sensor": sensor[None]})
            yield dict(zip(names, found, strict=True))


def images(cells: int, pitch: int) -> dict[str, F32]:
    """White of a pattern of dots: at rest, pressed in the middle, and of what no skin shows."""
    row, col = np.indices((cells, cells))
    across = [at % pitch - pitch // 2 for at in (row, col)]
    dots = across[0] ** 2 + across[1] ** 2 <= (pitch // 3) ** 2
    inside = (row - cells // 2) ** 2 + (col - cells // 2) ** 2
    pressed = np.where(inside < (cells // 4) ** 2, np.roll(dots, pitch // 2, 0), dots)
    noise = np.random.default_rng(pitch).integers(0, 256, (cells, cells)) / 255
    half = col < cells // 2
    every = {"rest": dots, "pressed": pressed, "noise": noise, "saturated": half}
    every |= {"black": np.zeros_like(dots), "white": np.ones_like(dots)}
    return {what: image.astype(np.float32) for what, image in every.items()}


@cache
def given(name: str) -> tuple[tuple[F32, F32], ...]:
    """White and the sensor's part for every sensor and image."""
    network = load_network(name) if name != "shear" else read_part(WEIGHTS / "shear.onnx")
    made = []
    for k, seed in enumerate(SENSORS):
        model = SensorModel() if seed is None else random_model(seed)
        geometry = model.geometry
        every = images(network.cells, 7 + 2 * k)
        pitch_px = model.pitch_mm / geometry.mm_per_px
        known = known_maps(geometry, pitch_px, every["rest"], network.fold)
        sensor = network.sense(known)
        made += [(fold(white[None], network.fold), sensor) for white in every.values()]
    return tuple(made)


def crc32(name: str) -> int:
    """CRC-32 of all codes on all images, in the graph's order."""
    network = Integers.shipped(name)
    names = [node.output for node in network.nodes if node.kind in CODED]
    found = 0
    for values in network.run(names, given(name)):
        for each in names:
            assert values[each].dtype == np.uint8
            found = zlib.crc32(values[each].tobytes(), found)
    return found


if __name__ == "__main__":
    print(json.dumps({name: f"{crc32(name):08x}" for name in NAMES}))
