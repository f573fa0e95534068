"""The weights inside an ONNX file: reads them and replaces them.

A fitted network is stored as its weights alone, so that a calibration contains numbers and never a
graph. This module reads only the fields that it needs of the format (Protocol Buffers, and ONNX's
``onnx.proto``). ONNX Runtime replaces a graph's weights by name, but states neither their names and
values nor the layout to which they belong. What is no such file raises ValueError.
"""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tacshade_edge.types import F32

# Field numbers of ModelProto, GraphProto, TensorProto, NodeProto and AttributeProto; a data type;
# wire types.
# https://protobuf.dev/programming-guides/encoding
# https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
_GRAPH = 7
_NODE, _INITIALIZER = 1, 5
_DIMS, _DATA_TYPE, _NAME, _RAW_DATA = 1, 2, 8, 9
_INPUT, _OUTPUT, _KIND, _ATTRIBUTE = 1, 2, 4, 5
_ATTRIBUTE_NAME, _INTEGER, _INTEGERS = 1, 3, 8
_FLOAT = 1
_VARINT, _BYTES = 0, 2
_FIXED_BYTES = {1: 8, 5: 4}
# A number's bytes hold seven bits each; the eighth says that another byte follows. Of 64 bits, the
# last byte holds the highest one: a longer number is no number, but would never end.
_SEVEN_BITS, _MORE, _LAST_SHIFT = 127, 128, 63


class Field(NamedTuple):
    """A field of a message: its value, or the range of its bytes in the file."""

    value: int
    begin: int
    end: int


@dataclass(frozen=True, slots=True)
class Weight:
    """A weight's name and shape, and the range of its float32 values in the file."""

    name: str
    shape: tuple[int, ...]
    begin: int
    end: int


@dataclass(frozen=True, slots=True)
class Node:
    """An operation, the names of its inputs and its output, and its integer attributes."""

    kind: str
    inputs: tuple[str, ...]
    output: str
    attributes: dict[str, int | tuple[int, ...]]


def fields(data: bytes, begin: int, end: int) -> dict[int, list[Field]]:
    """The fields of the message from `begin` to `end`, by number."""
    found: dict[int, list[Field]] = defaultdict(list)
    while begin < end:
        key, begin = _varint(data, begin)
        kind, value = key & 7, 0
        if kind == _VARINT:
            value, after = _varint(data, begin)
        elif kind == _BYTES:
            length, begin = _varint(data, begin)
            after = begin + length
        elif kind in _FIXED_BYTES:
            after = begin + _FIXED_BYTES[kind]
        else:
            raise ValueError(f"wire type {kind} at byte {begin}")
        if after > end:
            raise ValueError(f"the field at byte {begin} goes beyond its message")
        # The key holds the field's number above three bits of wire type.
        found[key >> 3].append(Field(value, begin, after))
        begin = after
    return found


def graph_of(data: bytes) -> Field:
    """The field of the graph."""
    return _one(fields(data, 0, len(data)), _GRAPH)


def weights_of(data: bytes) -> list[Weight]:
    """All weights, raw float32, in the file's order."""
    return [_weight(data, tensor) for tensor in _of_graph(data, _INITIALIZER)]


def nodes_of(data: bytes) -> list[Node]:
    """All operations, in the order of execution."""
    return [_node(data, node) for node in _of_graph(data, _NODE)]


def layout_of(*files: bytes) -> str:
    """Name that networks share if only their weights differ:
    hexadecimal SHA-256 of the rest of their graphs.
    """
    digest = hashlib.sha256()
    for data in files:
        graph = graph_of(data)
        blank = bytearray(data)
        for weight in weights_of(data):
            blank[weight.begin : weight.end] = bytes(weight.end - weight.begin)
        # The graph alone: the exporter writes its own version before it.
        digest.update(blank[graph.begin : graph.end])
    return digest.hexdigest()


def values_of(data: bytes) -> F32:
    """All weights end to end, float32 (P,)."""
    return np.concatenate(
        [np.frombuffer(data[weight.begin : weight.end], "<f4") for weight in weights_of(data)]
    )


def with_values(data: bytes, values: F32) -> bytes:
    """The same network with other weights, in the order of `values_of`.

    Raises ValueError if the number differs.
    """
    made, stored, at = bytearray(data), values.astype("<f4").tobytes(), 0
    for weight in weights_of(data):
        size = weight.end - weight.begin
        made[weight.begin : weight.end] = stored[at : at + size]
        at += size
    if at != len(stored) or len(made) != len(data):
        raise ValueError(f"found {len(stored) // 4} weights, expected {at // 4}")
    return bytes(made)


def with_weights_of(graph: bytes, data: bytes) -> bytes:
    """A network without weights, completed with those of another file."""
    tensors = (
        message(_INITIALIZER, data[one.begin : one.end]) for one in _of_graph(data, _INITIALIZER)
    )
    return joined(graph, b"".join(tensors))


def joined(graph: bytes, more: bytes) -> bytes:
    """A network with more fields in its graph: Protocol Buffers concatenates the lists
    of a repeated message.
    """
    # The same message twice is read as one, their lists end to end.
    return graph + message(_GRAPH, more)


def message(number: int, content: bytes) -> bytes:
    """A field that holds bytes or a message, encoded; its number is below 16."""
    made, left = bytearray([number << 3 | _BYTES]), len(content)
    while left > _SEVEN_BITS:
        made.append(left & _SEVEN_BITS | _MORE)
        left >>= 7
    return bytes(made) + bytes([left]) + content


def _of_graph(data: bytes, number: int) -> list[Field]:
    graph = graph_of(data)
    return fields(data, graph.begin, graph.end)[number]


def _one(found: dict[int, list[Field]], number: int) -> Field:
    if not found[number]:
        raise ValueError(f"no field {number}, for example no graph")
    return found[number][0]


def _weight(data: bytes, tensor: Field) -> Weight:
    parts = fields(data, tensor.begin, tensor.end)
    name, raw, shape = (
        _text(data, _one(parts, _NAME)),
        _one(parts, _RAW_DATA),
        tuple(d.value for d in parts[_DIMS]),
    )
    # ONNX knows other places for values (`float_data`, external files); our exporters write this
    # one, and anything else would be read as noise.
    if _one(parts, _DATA_TYPE).value != _FLOAT or 4 * math.prod(shape) != raw.end - raw.begin:
        raise ValueError(f"weight {name}: expected raw float32")
    return Weight(name, shape, raw.begin, raw.end)


def _node(data: bytes, node: Field) -> Node:
    parts = fields(data, node.begin, node.end)
    attributes: dict[str, int | tuple[int, ...]] = {}
    for attribute in parts[_ATTRIBUTE]:
        about = fields(data, attribute.begin, attribute.end)
        integers, one = tuple(each.value for each in about[_INTEGERS]), about[_INTEGER]
        attributes[_text(data, _one(about, _ATTRIBUTE_NAME))] = integers or (
            one[0].value if one else 0
        )
    inputs = tuple(_text(data, each) for each in parts[_INPUT])
    return Node(_text(data, _one(parts, _KIND)), inputs, _text(data, parts[_OUTPUT][0]), attributes)


def _text(data: bytes, field: Field) -> str:
    return data[field.begin : field.end].decode()


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number stored in 7 bits a byte, the lowest first, and the offset after it."""
    value = shift = 0
    while True:
        if at >= len(data) or shift > _LAST_SHIFT:
            raise ValueError(f"no number ends at byte {at}")
        byte = data[at]
        value |= (byte & _SEVEN_BITS) << shift
        at, shift = at + 1, shift + 7
        if byte < _MORE:
            return value, at
