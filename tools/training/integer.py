#!/usr/bin/env python3
"""Write the integer graph of a shipped network, ``NAME.integer.onnx``,
whose layers compute with 8-bit codes.

::

    .venv-train/bin/python -m tools.training.integer --data DATA --name fast
    .venv-train/bin/python -m tools.training.integer --data DATA --name shear --part 0.97

The graph has no weights: the reader adds those of ``NAME.onnx``, or fitted ones with the same
layout. It contains the operations and the scales of the codes. A scale covers the range of a
channel on the shards of make_data.py, in all frames or, with ``--part``, in that part of them;
greater values in the other frames are clipped to the last code.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

from tacshade_edge.sensor.inference.network import WEIGHTS
from tools.training.data import Data, batch, load, shards_in
from tools.training.exact_graph import exact
from tools.training.integer_graph import Channels, Graph, Network


def channels(
    network: Network, once: bytes, frames: Sequence[Data], part: float
) -> dict[str, Channels]:
    """Measure the tensors that become codes or that convolutions of codes read;
    ranges cover `part` of the frames.
    """
    names = sorted({*network.coded, *network.read})
    model = onnx.ModelProto()
    model.CopyFrom(network.model)
    model.graph.output.extend(onnx.ValueInfoProto(name=name) for name in names)
    run, sense = _session(model.SerializeToString()), _session(once)
    found: dict[str, list[tuple[np.ndarray, ...]]] = {name: [] for name in names}
    for white, known in _inputs(frames):
        sensor = sense.run(None, {"known": known})[0]
        for name, values in zip(
            names, run.run(names, {"white": white, "sensor": sensor}), strict=True
        ):
            found[name].append(
                (values.min((0, 2, 3)), values.max((0, 2, 3)), values.mean((0, 2, 3)))
            )
    return {
        name: _over_frames([np.array(each, np.float64) for each in zip(*rows, strict=True)], part)
        for name, rows in found.items()
    }


def _over_frames(found: Sequence[np.ndarray], part: float) -> Channels:
    least, most, mean = found
    ends = np.quantile(least, 1 - part, axis=0), np.quantile(most, part, axis=0)
    return Channels(np.minimum(ends[0], 0), np.maximum(ends[1], 0), mean.mean(0))


def _inputs(frames: Sequence[Data]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for data in frames:
        for k in range(len(data.frame)):
            x = batch(data, np.array([k]))[0].contiguous().numpy()
            yield (
                np.ascontiguousarray(x[:, : data.fold**2]),
                np.ascontiguousarray(x[:, data.fold**2 :]),
            )


def _session(data: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])


def main() -> None:
    """Measure the ranges and write the graph."""
    parser = argparse.ArgumentParser(description="Write the integer graph of a shipped network.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--name", required=True)
    parser.add_argument(
        "--part", type=float, default=1.0, help="of the frames whose values the codes hold"
    )
    args = parser.parse_args()
    path = WEIGHTS / f"{args.name}.onnx"
    about = json.loads(path.with_suffix(".json").read_text())
    frames = [load(paths, about["fold"], about["cells"]) for paths in shards_in(args.data).values()]
    network = Network(onnx.load(path))
    found = channels(network, path.with_suffix(".sensor.onnx").read_bytes(), frames, args.part)
    nodes, model = Graph(network, found).nodes, network.model
    del model.graph.node[:], model.graph.initializer[:], model.graph.value_info[:]
    model.graph.node.extend(nodes)
    exact(model)
    out = path.with_suffix(".integer.onnx")
    out.write_bytes(model.SerializeToString())
    about["sha256"][out.name] = hashlib.sha256(out.read_bytes()).hexdigest()
    about["integer_frames"] = sum(len(data.frame) for data in frames)
    about["integer_part"] = args.part
    path.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    main()
