#!/usr/bin/env python3
"""Write a checkpoint as ONNX, prove that ONNX Runtime runs it alike, and say where it came from.

::

    .venv-train/bin/python -m tools.training.export --run RUN --out accurate.onnx [--shipped-part 0.5]

The first layer is cut in two: what the sensor's reference and geometry add to it goes to ``accurate.sensor.onnx``,
which is run once for a sensor; the rest, which takes a frame's white and that, is run for every frame. Beside them goes
a JSON file of the same name: command, seed, commit, data, figures, SHA-256.

A short run on other data than the shipped weights had forgets some of theirs. ``--shipped-part`` gives it back: weights
on the way from the run's to the shipped ones, which it began with, are often better than either on both
(Wortsman et al., CVPR 2022).
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import json
import subprocess
import warnings
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_weights

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.inference.onnx_weights import values_of, with_values
from tools.training.network import Net, ShearNet, trained
from tools.training.shipped import WEIGHTS

OPSET = 13
TOLERANCE = 1e-4
OUTPUTS = {"depth": ["depth_and_contact", "foreign"], "shear": ["displacement"]}
"""Of `network.NETS`, as the tensors of the shipped files are called: those names are of their bytes and stay."""


class PerSensor(nn.Module):
    """What the maps that are known of a sensor add to the first convolution."""

    def __init__(self, net: Net | ShearNet) -> None:
        super().__init__()
        weight, bias = first_layer(net)
        self.register_buffer("weight", weight[:, net.fold**2 :])
        self.register_buffer("bias", bias)

    def forward(self, known: Tensor) -> Tensor:
        """Run it."""
        return functional.conv2d(known, self.weight, self.bias, padding=1)


class PerFrame(nn.Module):
    """The network from a frame's white and what `PerSensor` gave."""

    def __init__(self, net: Net | ShearNet) -> None:
        super().__init__()
        self.rest = copy.deepcopy(net)
        self.rest.down[0] = self.rest.down[0][3:]
        self.register_buffer("weight", first_layer(net)[0][:, : net.fold**2])

    def forward(self, white: Tensor, sensor: Tensor) -> tuple[Tensor, ...]:
        """Run it."""
        made = self.rest(functional.relu(functional.conv2d(white, self.weight, padding=1) + sensor))
        return made if isinstance(made, tuple) else (made,)


def first_layer(net: Net | ShearNet) -> tuple[Tensor, Tensor]:
    """Weight and bias of the first convolution with its normalisation."""
    conv, norm = net.down[0][0], net.down[0][1]
    fused = fuse_conv_bn_weights(
        conv.weight, None, norm.running_mean, norm.running_var, norm.eps, norm.weight, norm.bias
    )
    return fused[0].detach(), fused[1].detach()


def main() -> None:
    """Export and check."""
    parser = argparse.ArgumentParser(description="Export the learned inverse.")
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--shipped-part", type=float, default=0.0, help="of the shipped weights of its name; 0 to 1")
    args = parser.parse_args()
    net, state = trained(args.run)
    fold = net.fold
    cells = int(state["arguments"].get("cells", disc_map.CELLS))
    shape = (1, net.down[0][0].in_channels, cells // fold, cells // fold)
    x = torch.rand(shape, generator=torch.Generator().manual_seed(1))
    white, known = x[:, : fold**2], x[:, fold**2 :]
    once, outputs = args.out.with_suffix(".sensor.onnx"), OUTPUTS[state["arguments"].get("net", "depth")]
    with torch.no_grad():
        made = net(x)
        sensor = PerSensor(net)(known)
    expected = [y.numpy() for y in (made if isinstance(made, tuple) else (made,))]
    write(PerSensor(net), {"known": known}, ["sensor"], once)
    write(PerFrame(net), {"white": white, "sensor": sensor}, outputs, args.out)
    found = run(args.out, {"white": white.numpy(), "sensor": run(once, {"known": known.numpy()})[0]})
    off = max(float(np.abs(f - e).max()) for f, e in zip(found, expected, strict=True))
    if args.shipped_part:
        for path in (args.out, once):
            blend(path, WEIGHTS / path.name, args.shipped_part)
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    rows = [json.loads(line) for line in (args.run / "figures.jsonl").read_text().splitlines()]
    about = {
        "sha256": {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (args.out, once)},
        "cells": cells,
        "fold": fold,
        "parameters": sum(p.numel() for p in net.parameters()),
        "commit": commit,
        "training": {k: v for k, v in state["arguments"].items() if k not in ("data", "out", "start")},
        "steps": state["step"],
        "shards": state["shards"],
        "figures": {k: v for k, v in rows[-1].items() if k != "s_per_step"},
        "run_minus_torch": off,
        "shipped_part": args.shipped_part,
    }
    args.out.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n")
    print(json.dumps(about, indent=1))
    if off > TOLERANCE:
        raise SystemExit(f"its result differs by {off}, at most {TOLERANCE} was expected")


def write(part: nn.Module, inputs: dict[str, Tensor], outputs: list[str], path: Path) -> None:
    """Write a part of the network."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the exporter that needs nothing beside torch
        torch.onnx.export(part.eval(), tuple(inputs.values()), str(path), dynamo=False, opset_version=OPSET,
                          input_names=list(inputs), output_names=outputs)  # fmt: skip


def blend(path: Path, shipped: Path, part: float) -> None:
    """Move the weights of a file that part of the way to those that are committed."""
    name = shipped.relative_to(Path.cwd()).as_posix()
    old = subprocess.run(["git", "show", f"HEAD:{name}"], capture_output=True, check=True).stdout
    made = path.read_bytes()
    path.write_bytes(with_values(made, (1 - part) * values_of(made) + part * values_of(old)))


def run(path: Path, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Run a part as the project does."""
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(None, inputs)


if __name__ == "__main__":
    main()
