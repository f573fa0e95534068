#!/usr/bin/env python3
"""Make the floats around the codes of an integer graph exact,
so that every processor computes the same codes.

::

    .venv-train/bin/python -m tools.training.exact_graph fast balanced accurate shear

A float32 sum of multiples of one power of two is exact, in any order and with any instructions, as
long as no part of it exceeds 2**24 of them. Therefore the graph rounds white to codes, the first
layer's weights to a step, and what rounding the other weights takes from their sums. Where codes
are added, their scales are such that no sum is near the middle between two codes. `integer.py` does
this to each graph that it writes; the command does it to the shipped ones, and changes nothing that
is exact already.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, helper, numpy_helper

from tacshade_edge.sensor.inference.network import WEIGHTS

WHITE = 255
"""Codes of white, uint8: 0 to 1 in steps of 1/255."""
SUM_BITS = 18
"""Bits behind the point of the first layer's sums: exact below 64 (float32 has 24)."""
LOST_BITS = 6
"""Bits behind the point of what rounding takes: a mean code times half a step is at most 128, and a
channel has at most 2048 weights, so that sums are exact.
"""
PARTS = 2047
"""A term's scale is a whole number of so many parts of the sum's.

The number is odd, so that a sum is at least half a part, 2.4e-4, from the middle between two codes;
float32 errs by 1e-4 at most, in whatever order the runtime adds.
"""


def exact(model: onnx.ModelProto) -> None:
    """Replace the graph's nodes."""
    nodes = list(model.graph.node)
    if any(node.output[0] == "white_codes" for node in nodes):
        return
    _add_exactly(nodes)
    made = [new for node in nodes for new in _exact(node)]
    del model.graph.node[:]
    model.graph.node.extend(made)


def _add_exactly(nodes: Sequence[NodeProto]) -> None:
    """Replace the scales of codes that are added, everywhere."""
    maker = {node.output[0]: node for node in nodes}
    value = {
        node.output[0]: numpy_helper.to_array(node.attribute[0].t)
        for node in nodes
        if node.op_type == "Constant"
    }
    new_scale: dict[np.float32, np.float32] = {}
    for node in nodes:
        terms = _terms(node, maker)
        if terms:  # they are a hundredth greater at most
            whole = float(value[node.input[1]])
            for term in terms:
                scale = np.float32(value[term.input[1]])
                parts = math.ceil(PARTS * (scale / whole))
                new_scale[scale] = np.float32(whole * (parts / PARTS))
    for name, old in value.items():
        if old.dtype != np.float32:
            continue
        new = np.array([new_scale.get(each, each) for each in old.ravel()], np.float32)
        _set(maker[name], new.reshape(old.shape))
        for mean in _means(name, nodes, maker):  # in codes
            _set(maker[mean], (value[mean] * (old / new.reshape(old.shape))).astype(np.float32))


def _terms(node: NodeProto, maker: Mapping[str, NodeProto]) -> list[NodeProto]:
    """The nodes that make values of the codes that this one adds, if it makes codes of a sum."""
    of = maker.get(node.input[0]) if node.op_type == "QuantizeLinear" else None
    terms = [maker.get(name) for name in of.input] if of and of.op_type == "Add" else []
    return [each for each in terms if each and each.op_type == "DequantizeLinear"]


def _means(scale: str, nodes: Sequence[NodeProto], maker: Mapping[str, NodeProto]) -> list[str]:
    """The mean codes that correct the bias of a convolution of codes in this scale."""
    found = []
    for node in nodes:
        lost = maker.get(node.input[0]) if node.op_type == "Mul" else None
        if lost is not None and lost.op_type == "Sub":
            weight = maker[maker[lost.input[0]].input[0]]
            found += [node.input[1]] if weight.input[1] == scale else []
    return found


def _set(constant: NodeProto, value: np.ndarray) -> None:
    constant.attribute[0].t.CopyFrom(numpy_helper.from_array(value))


def _exact(node: NodeProto) -> Iterator[NodeProto]:
    if node.op_type == "Conv" and node.input[0] == "white":
        yield from _first_layer(node)
    elif node.op_type == "ReduceSum":
        name, scale = node.input[0], np.float32(2**LOST_BITS)
        yield from _rounded(name, scale, 1 / scale, f"{name}_exact")
        node.input[0] = f"{name}_exact"
        yield node
    else:
        yield node


def _first_layer(node: NodeProto) -> Iterator[NodeProto]:
    """The convolution of white, of its codes: the weights absorb their scale."""
    weight = node.input[1]
    yield _constant("white_scale", np.float32(1 / WHITE))
    yield _constant("white_zero", np.uint8(0))
    given = ["white", "white_scale", "white_zero"]
    yield helper.make_node("QuantizeLinear", given, ["white_codes"])
    yield helper.make_node("Cast", ["white_codes"], ["white_values"], to=TensorProto.FLOAT)
    per_code, step = np.float32(2**SUM_BITS / WHITE), np.float32(2**-SUM_BITS)
    yield from _rounded(weight, per_code, step, "white_weight")
    node.input[0], node.input[1] = "white_values", "white_weight"
    yield node


def _rounded(name: str, times: np.floating, back: np.floating, result: str) -> Iterator[NodeProto]:
    """``round(name * times) * back``."""
    yield _constant(f"{result}_times", times)
    yield _constant(f"{result}_back", np.float32(back))
    yield helper.make_node("Mul", [name, f"{result}_times"], [f"{result}_scaled"])
    yield helper.make_node("Round", [f"{result}_scaled"], [f"{result}_whole"])
    yield helper.make_node("Mul", [f"{result}_whole", f"{result}_back"], [result])


def _constant(name: str, value: np.generic) -> NodeProto:
    return helper.make_node(
        "Constant", [], [name], value=numpy_helper.from_array(np.asarray(value))
    )


def main() -> None:
    """Rewrite the graphs and their hashes."""
    parser = argparse.ArgumentParser(description="Make the shipped integer graphs exact.")
    parser.add_argument("names", nargs="+", metavar="NAME")
    for name in parser.parse_args().names:
        path = WEIGHTS / f"{name}.integer.onnx"
        model = onnx.load(path)
        exact(model)
        path.write_bytes(model.SerializeToString())
        about = json.loads((WEIGHTS / f"{name}.json").read_text())
        about["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
        (WEIGHTS / f"{name}.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
