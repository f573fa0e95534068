"""Turn a float network into a graph on 8-bit codes without weights,
which rounds the float weights added to it.

docs/explanation/numerics.md describes the codes and lists the layers that stay in float32.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

OUTPUTS = ("depth_and_contact", "foreign", "displacement")
"""Output tensors of the shipped depth networks and of the shear network (`export.OUTPUTS`)."""
MOST_CODE, MOST_WEIGHT = 255, 63
"""x86-64 without VNNI adds two products in int16 and saturates larger sums; 2 * 255 * 63 fits."""
LEAST_RANGE = 1e-3
"""Range of a channel that is always 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """The values of a tensor's channels on frames, float64 (C,)."""

    least: np.ndarray
    most: np.ndarray
    mean: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Tensor:
    """A tensor of the integer graph: a value is its channel's scale (C,) or (1,) times
    (code - `zero`).

    `zero` is an int for uint8 codes, and None for float32,
    which the scale in the next weights multiplies.
    """

    name: str
    scale: np.ndarray
    zero: int | None


class Network:
    """A float network: its nodes, and the nodes that make and read each tensor."""

    def __init__(self, model: onnx.ModelProto) -> None:
        self.model = model
        self.nodes = [node for node in model.graph.node if node.op_type != "Constant"]
        self.maker = {node.output[0]: node for node in self.nodes}
        heads = [self.head(output.name) for output in model.graph.output]
        self.read_by_heads = {head.input[0] for head in heads}
        in_float = [*heads]
        if (
            OUTPUTS[0] in self.maker
        ):  # the other values of this tensor are 20 times as large as the heights
            in_float.append(self.maker[self.maker[self.maker[OUTPUTS[0]].input[0]].input[0]])
        convolutions = [node for node in self.nodes if node.op_type == "Conv"]
        sums = [node for node in self.nodes if node.op_type == "Add" and "sensor" not in node.input]
        coded = [node for node in convolutions if node not in in_float]
        self.coded = [self.result(node) for node in coded] + [node.output[0] for node in sums]
        self.read = sorted({node.input[0] for node in coded[1:]})
        self.one_scale = {
            self.source(name) for node in sums for name in (*node.input, *node.output)
        }
        self.one_scale.add(self.result(convolutions[0]))

    def head(self, output: str) -> NodeProto:
        """The convolution that computes an output."""
        node = self.maker[output]
        return node if node.op_type == "Conv" else self.maker[node.input[0]]

    def result(self, convolution: NodeProto) -> str:
        """The result of a convolution, after the sensor's part and the ReLU if it has them."""
        name = convolution.output[0]
        while len(after := [node for node in self.nodes if name in node.input]) == 1:
            if after[0].op_type != "Relu" and "sensor" not in after[0].input:
                break
            name = after[0].output[0]
        return name

    def source(self, name: str) -> str:
        """The tensor from which a resized one was made."""
        while self.maker[name].op_type == "Resize":
            name = self.maker[name].input[0]
        return name

    def side(self, name: str) -> int:
        """Number of cells along a side of a tensor."""
        node, side = (
            self.maker[name],
            self.model.graph.input[0].type.tensor_type.shape.dim[3].dim_value,
        )
        while True:
            if node.op_type in ("Resize", "MaxPool"):
                side = 2 * side if node.op_type == "Resize" else side // 2
            if node.input[0] == "white":
                return side
            node = self.maker[node.input[0]]

    def width(self, name: str) -> int:
        """Number of channels of a tensor that was not joined."""
        node = self.maker[name]
        while node.op_type != "Conv":
            node = self.maker[node.input[0]]
        return next(
            each.dims[0] for each in self.model.graph.initializer if each.name == node.input[1]
        )


def scales(network: Network, found: dict[str, Channels]) -> dict[str, Tensor]:
    """Choose scale and zero of the tensors that become codes.

    A channel's scale is the geometric mean of what the channel itself needs and what the widest
    channel of its tensor needs. This makes its codes finer, and the weights that absorb the scale
    are rounded hardly more coarsely. Where tensors are added or float32 becomes codes, all channels
    share one scale.
    """
    made = {}
    for name in network.coded:
        least, most = found[name].least, found[name].most
        width = np.maximum(most - least, LEAST_RANGE)
        if name in network.one_scale:
            width[:] = most.max() - least.min()
        scale = (np.sqrt(width * width.max()) / MOST_CODE).astype(np.float32)
        made[name] = Tensor(name, scale, round(float(-least.min() / scale[0])))
    return made


class Graph:
    """The integer graph, made node by node; inputs,
    outputs and weights keep their names of the float network.
    """

    def __init__(self, network: Network, found: dict[str, Channels]) -> None:
        self.nodes: list[NodeProto] = []
        self._network, self._found, self._coded = network, found, scales(network, found)
        self._made = {"white": Tensor("white", np.ones(1, np.float32), None)}
        self._one, self._weight_zero = self._constant(np.float32(1)), self._constant(np.int8(0))
        make = {
            "Conv": self._convolution,
            "Relu": self._relu,
            "Add": self._sum,
            "Concat": self._joined,
            "MaxPool": self._moved,
            "Resize": self._doubled,
            "DepthToSpace": self._moved,
        }
        for node in network.nodes:
            make[node.op_type](node)

    def _convolution(self, node: NodeProto) -> None:
        x, result = self._made[node.input[0]], self._network.result(node)
        if result in self._coded and x.zero is not None:
            self._made[result] = self._of_codes(node, x, self._coded[result])
            return
        weight = node.input[1] if (x.scale == 1).all() else self._scaled(node.input[1], x.scale)
        self._float(node, "Conv", self._cast(x), weight, *node.input[2:])

    def _of_codes(self, node: NodeProto, x: Tensor, coded: Tensor) -> Tensor:
        """Make a convolution from codes to codes; it includes the ReLU,
        because codes are never below 0.
        """
        weight = self._scaled(node.input[1], x.scale)
        most = self._op("ReduceMax", self._op("Abs", weight), axes=[1, 2, 3], keepdims=1)
        most = self._op("Max", most, self._constant(np.float32(1e-9)))
        step = self._op("Div", most, self._constant(np.float32(MOST_WEIGHT)))
        weight = self._op("Div", weight, step)
        rounded = self._op("Round", weight)
        step = self._op("Reshape", step, self._constant(np.array([-1])))
        # The bias corrects the mean error that rounding the weights causes in the sums
        # (Nagel et al., ICCV 2019).
        mean = (self._found[node.input[0]].mean / x.scale).astype(np.float32).reshape(1, -1, 1, 1)
        lost = self._op("Mul", self._op("Sub", weight, rounded), self._constant(mean))
        bias = self._op("ReduceSum", lost, self._constant(np.array([1, 2, 3])), keepdims=0)
        for name in node.input[2:]:
            bias = self._op("Add", self._op("Div", name, step), bias)
        bias = self._op("Cast", self._op("Round", bias), to=TensorProto.INT32)
        weight = self._op("Cast", rounded, to=TensorProto.INT8)
        step = self._op("Div", step, self._constant(coded.scale))
        zero, to_zero = (self._zero(each) for each in (x, coded))
        inputs = (
            x.name,
            self._one,
            zero,
            weight,
            step,
            self._weight_zero,
            self._one,
            to_zero,
            bias,
        )
        return Tensor(self._op("QLinearConv", *inputs, like=node), coded.scale, coded.zero)

    def _relu(self, node: NodeProto) -> None:
        name = node.output[0]
        if name in self._made:  # of codes
            return
        self._float(node, "Relu", self._made[node.input[0]].name)
        if name in self._coded:
            self._quantise(name, self._made[name].name)

    def _sum(self, node: NodeProto) -> None:
        if "sensor" in node.input:
            self._float(
                node,
                "Add",
                *(self._made[name].name if name in self._made else name for name in node.input),
            )
            return
        given = [self._made[name] for name in node.input]
        values = [self._op("DequantizeLinear", x.name, *self._scale_and_zero(x)) for x in given]
        self._quantise(node.output[0], self._op("Add", *values))

    def _joined(self, node: NodeProto) -> None:
        given = [self._made[name] for name in node.input]
        widths = [self._network.width(name) for name in node.input]
        scale = np.concatenate(
            [np.broadcast_to(x.scale, width) for x, width in zip(given, widths, strict=True)]
        )
        as_float = node.output[0] in self._network.read_by_heads
        name = self._op("Concat", *(self._cast(x) if as_float else x.name for x in given), axis=1)
        self._made[node.output[0]] = Tensor(name, scale, None if as_float else 0)

    def _moved(self, node: NodeProto) -> None:
        """Make a node that only moves numbers."""
        x = self._made[node.input[0]]
        name = self._op(node.op_type, x.name, like=node, name=_own(node))
        self._made[node.output[0]] = Tensor(name, x.scale, x.zero)

    def _doubled(self, node: NodeProto) -> None:
        """Double each cell in both directions by copies,
        five times as fast as the runtime's Resize.

        Channels come last, because the runtime keeps codes in this order.
        """
        x, channels = self._made[node.input[0]], self._network.width(node.input[0])
        side = self._network.side(node.input[0])
        name = self._op("Transpose", x.name, perm=[0, 2, 3, 1])
        for shape in ((side * side, 1, channels), (side, 1, 2 * side * channels)):
            name = self._op("Reshape", name, self._constant(np.array(shape)))
            name = self._op("Concat", name, name, axis=1)
        name = self._op(
            "Reshape", name, self._constant(np.array((1, 2 * side, 2 * side, channels)))
        )
        name = self._op("Transpose", name, perm=[0, 3, 1, 2])
        self._made[node.output[0]] = Tensor(name, x.scale, x.zero)

    def _float(self, node: NodeProto, kind: str, *inputs: str) -> None:
        name = self._op(kind, *inputs, like=node, name=_own(node))
        self._made[node.output[0]] = Tensor(name, np.ones(1, np.float32), None)

    def _quantise(self, output: str, values: str) -> None:
        coded = self._coded[output]
        name = self._op("QuantizeLinear", values, *self._scale_and_zero(coded))
        self._made[output] = Tensor(name, coded.scale, coded.zero)

    def _scale_and_zero(self, x: Tensor) -> tuple[str, str]:
        return self._constant(x.scale[0]), self._zero(x)

    def _zero(self, x: Tensor) -> str:
        assert x.zero is not None
        return self._constant(np.uint8(x.zero))

    def _cast(self, x: Tensor) -> str:
        return x.name if x.zero is None else self._op("Cast", x.name, to=TensorProto.FLOAT)

    def _scaled(self, weight: str, scale: np.ndarray) -> str:
        return self._op("Mul", weight, self._constant(scale.reshape(1, -1, 1, 1)))

    def _constant(self, value: np.ndarray | np.generic) -> str:
        return self._op("Constant", value=numpy_helper.from_array(np.asarray(value)))

    def _op(
        self,
        kind: str,
        *inputs: str,
        like: NodeProto | None = None,
        name: str | None = None,
        **attributes: object,
    ) -> str:
        name = name or f"{kind}_{len(self.nodes)}"
        made = helper.make_node(kind, inputs, [name], **attributes)
        made.attribute.extend(like.attribute if like is not None else ())
        self.nodes.append(made)
        return name


def _own(node: NodeProto) -> str | None:
    """The name of a node's output if it is an output of the network, which keeps its name."""
    return node.output[0] if node.output[0] in OUTPUTS else None
