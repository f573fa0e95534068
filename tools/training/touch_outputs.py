#!/usr/bin/env python3
"""Write graphs that pool the shipped integer graphs' activations for touch models,
``NAME.touch.onnx``.

::

    .venv-train/bin/python -m tools.training.touch_outputs

The file is a graph with some nodes and one output, ``features``; appended to ``NAME.integer.onnx``,
it gives one graph. The activations are those of the fourth convolution and of the first output,
averaged over 7 x 7 places. Early activations suit any skin, whereas those between suit only the
simulated skins that the networks were trained on.
"""

from __future__ import annotations

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper

from tacshade_edge.sensor.inference.network import WEIGHTS, in_integers

NAMES = ("fast", "balanced", "accurate", "shear")
PLACES = 7
LAYER = 2
"""Index among the integer convolutions; the network's first convolution is float."""


def pooling(name: str) -> onnx.ModelProto:
    """Make the nodes that follow a network's integer graph."""
    path = WEIGHTS / f"{name}.onnx"
    model = onnx.ModelProto()
    model.ParseFromString(in_integers(path, path.read_bytes()))
    convolutions = [node.output[0] for node in model.graph.node if node.op_type == "QLinearConv"]
    taken = [convolutions[LAYER], model.graph.output[0].name]
    sides = _sides(model, taken)
    nodes = []
    for k, (tensor, side) in enumerate(zip(taken, sides, strict=True)):
        step = [side // PLACES] * 2
        nodes += [
            helper.make_node("Cast", [tensor], [f"touch_float_{k}"], to=TensorProto.FLOAT),
            helper.make_node(
                "AveragePool",
                [f"touch_float_{k}"],
                [f"touch_pooled_{k}"],
                kernel_shape=step,
                strides=step,
            ),
            helper.make_node("Flatten", [f"touch_pooled_{k}"], [f"touch_flat_{k}"]),
        ]
    flat = [f"touch_flat_{k}" for k in range(len(taken))]
    nodes.append(helper.make_node("Concat", flat, ["features"], axis=1))
    made = onnx.ModelProto()
    made.graph.node.extend(nodes)
    made.graph.output.append(onnx.ValueInfoProto(name="features"))
    return made


def _sides(model: onnx.ModelProto, tensors: list[str]) -> list[int]:
    whole = onnx.ModelProto()
    whole.CopyFrom(model)
    whole.graph.output.extend(onnx.ValueInfoProto(name=name) for name in tensors)
    session = onnxruntime.InferenceSession(
        whole.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    inputs = {one.name: np.zeros(one.shape, np.float32) for one in session.get_inputs()}
    sides = [answer.shape[-1] for answer in session.run(tensors, inputs)]
    if any(side % PLACES for side in sides):
        raise ValueError(f"sides {sides} are no multiples of {PLACES}")
    return sides


def main() -> None:
    """Write the files of all networks."""
    for name in NAMES:
        out = WEIGHTS / f"{name}.touch.onnx"
        out.write_bytes(pooling(name).SerializeToString())
        print(f"{out.name}: {out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
