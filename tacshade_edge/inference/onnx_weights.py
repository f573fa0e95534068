"""The weights inside an ONNX file: reads them and replaces them.

A fitted network is stored as its weights alone, so that a calibration contains numbers and never a graph. This module
reads only the fields that it needs of the format (Protocol Buffers, and ONNX's ``onnx.proto``). ONNX Runtime replaces a
graph's weights by name, but states neither their names and values nor the layout to which they belong.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F32

# Field numbers of ModelProto, GraphProto, TensorProto, NodeProto and AttributeProto; a data type; wire types.
_GRAPH = 7
_NODE, _INITIALIZER = 1, 5
_DIMS, _DATA_TYPE, _NAME, _RAW_DATA = 1, 2, 8, 9
_INPUT, _OUTPUT, _KIND, _ATTRIBUTE = 1, 2, 4, 5
_ATTRIBUTE_NAME, _INTEGER, _INTEGERS = 1, 3, 8
_FLOAT = 1
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message: its number, and its value or the range of its bytes in the file."""

    number: int
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


def fields(data: bytes, begin: int, end: int) -> Iterator[Field]:
    """The fields of the message from `begin` to `end`. Raises ValueError if these bytes are no message."""
    while begin < end:
        key, begin = _varint(data, begin)
        number, kind, value = key >> 3, key & 7, 0
        if kind == _VARINT:
            value, after = _varint(data, begin)
        elif kind == _BYTES:
            length, begin = _varint(data, begin)
            after = begin + length
        elif kind in (_FIXED32, _FIXED64):
            after = begin + (4 if kind == _FIXED32 else 8)
        else:
            raise ValueError(f"wire type {kind} at byte {begin}")
        if after > end:
            raise ValueError(f"the field at byte {begin} goes beyond its message")
        yield Field(number, value, begin, after)
        begin = after


def graph_of(data: bytes) -> Field:
    """The field of the graph. Raises ValueError if there is none."""
    for field in fields(data, 0, len(data)):
        if field.number == _GRAPH:
            return field
    raise ValueError("no graph")


def weights_of(data: bytes) -> list[Weight]:
    """All weights, in the file's order. Raises ValueError if one is not raw float32."""
    graph = graph_of(data)
    return [_weight(data, field) for field in fields(data, graph.begin, graph.end) if field.number == _INITIALIZER]


def nodes_of(data: bytes) -> list[Node]:
    """All operations, in the order of execution."""
    graph = graph_of(data)
    return [_node(data, field) for field in fields(data, graph.begin, graph.end) if field.number == _NODE]


def layout_of(*files: bytes) -> str:
    """Name that networks share if only their weights differ: hexadecimal SHA-256 of the rest of their graphs."""
    digest = hashlib.sha256()
    for data in files:
        graph = graph_of(data)
        blank = bytearray(data)
        for weight in weights_of(data):
            blank[weight.begin : weight.end] = bytes(weight.end - weight.begin)
        digest.update(blank[graph.begin : graph.end])
    return digest.hexdigest()


def values_of(data: bytes) -> F32:
    """All weights end to end, float32 (P,)."""
    return np.concatenate([np.frombuffer(data[weight.begin : weight.end], "<f4") for weight in weights_of(data)])


def with_values(data: bytes, values: F32) -> bytes:
    """The same network with other weights, in the order of `values_of`. Raises ValueError if the number differs."""
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
    lies = graph_of(data)
    weights = b"".join(
        message(_INITIALIZER, data[field.begin : field.end])
        for field in fields(data, lies.begin, lies.end)
        if field.number == _INITIALIZER
    )
    return joined(graph, weights)


def joined(graph: bytes, more: bytes) -> bytes:
    """A network with more fields in its graph: Protocol Buffers concatenates the lists of a repeated message."""
    return graph + message(_GRAPH, more)


def message(number: int, content: bytes) -> bytes:
    """A field that holds bytes or a message, encoded; its number is below 16."""
    made, left = bytearray([number << 3 | _BYTES]), len(content)
    while left > 127:
        made.append(left & 127 | 128)
        left >>= 7
    return bytes(made) + bytes([left]) + content


def _weight(data: bytes, tensor: Field) -> Weight:
    shape: list[int] = []
    name, raw, kind = "", None, 0
    for field in fields(data, tensor.begin, tensor.end):
        if field.number == _DIMS:
            shape.append(field.value)
        elif field.number == _DATA_TYPE:
            kind = field.value
        elif field.number == _NAME:
            name = data[field.begin : field.end].decode()
        elif field.number == _RAW_DATA:
            raw = field
    if raw is None or kind != _FLOAT or 4 * math.prod(shape) != raw.end - raw.begin:
        raise ValueError(f"weight {name}: expected raw float32")
    return Weight(name, tuple(shape), raw.begin, raw.end)


def _node(data: bytes, node: Field) -> Node:
    names: dict[int, list[str]] = {_INPUT: [], _OUTPUT: [], _KIND: []}
    attributes: dict[str, int | tuple[int, ...]] = {}
    for field in fields(data, node.begin, node.end):
        if field.number in names:
            names[field.number].append(data[field.begin : field.end].decode())
        elif field.number == _ATTRIBUTE:
            parts = list(fields(data, field.begin, field.end))
            name = next(data[part.begin : part.end].decode() for part in parts if part.number == _ATTRIBUTE_NAME)
            several = tuple(part.value for part in parts if part.number == _INTEGERS)
            one = [part.value for part in parts if part.number == _INTEGER]
            attributes[name] = several or (one[0] if one else 0)
    return Node(names[_KIND][0], tuple(names[_INPUT]), names[_OUTPUT][0], attributes)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number stored in 7 bits a byte, the lowest first, and the offset after it."""
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise ValueError(f"no number ends at byte {at}")
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
