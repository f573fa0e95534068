from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.sensor.inference.network import network_files
from tacshade_edge.sensor.inference.onnx_weights import (
    fields,
    graph_of,
    layout_of,
    message,
    nodes_of,
    values_of,
    weights_of,
    with_values,
    with_weights_of,
)

NAMES = ("accurate", "balanced", "fast", "shear")
FAST = network_files("fast")[0]


@pytest.mark.parametrize("name", NAMES)
def test_its_own_weights_change_nothing_and_others_not_the_layout(name: str) -> None:
    for data in network_files(name):
        values = values_of(data)
        assert with_values(data, values) == data
        other = with_values(data, values + np.float32(1))
        assert other != data
        assert layout_of(other) == layout_of(data)
        np.testing.assert_array_equal(values_of(other), values + np.float32(1))


def test_a_graph_takes_the_weights_of_another_file() -> None:
    """Also weights longer than a length of one byte states;
    whoever reads the file finds them in a second graph.
    """
    graph = graph_of(FAST)
    nodes = b"".join(
        message(1, FAST[f.begin : f.end]) for f in fields(FAST, graph.begin, graph.end)[1]
    )
    bare = message(7, nodes)
    made = with_weights_of(bare, FAST)
    assert made.startswith(bare)
    assert nodes_of(made) == nodes_of(FAST)
    np.testing.assert_array_equal(values_of(made[len(bare) :]), values_of(FAST))


@pytest.mark.parametrize("count", [-1, 1])
def test_as_many_weights_as_there_are(count: int) -> None:
    values = values_of(FAST)
    with pytest.raises(ValueError, match=f"expected {len(values)}"):
        with_values(FAST, np.resize(values, len(values) + count))


def test_the_operations_are_in_their_order() -> None:
    nodes = nodes_of(FAST)
    known = {"white", "sensor", *(weight.name for weight in weights_of(FAST))}
    for node in nodes:
        assert {name for name in node.inputs if name} <= known
        known.add(node.output)
    assert {"depth_and_contact", "foreign"} <= known
    assert nodes[0].attributes["pads"] == (1, 1, 1, 1)


@given(st.binary(max_size=200))
def test_other_bytes_have_no_weights(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        assert weights_of(data) == []  # an empty graph is one


def test_a_file_that_was_cut_is_refused() -> None:
    for length in range(1, len(FAST), 5011):
        with pytest.raises(ValueError, match=r"no field|ends at byte|beyond"):
            weights_of(FAST[:length])
