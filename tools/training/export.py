#!/usr/bin/env python3
"""Write a checkpoint as ONNX, check that ONNX Runtime gives the same results,
and record the origin.

::

    .venv-train/bin/python -m tools.training.export --run RUN --out accurate.onnx

The first layer is cut in two. ``accurate.sensor.onnx`` computes what the sensor's reference and
geometry contribute and runs once per sensor. The rest takes this contribution and a frame's white,
and runs for every frame. A JSON file of the same name records command, seed, commit, data, figures
and SHA-256.
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

from tacshade_edge.sensor.geometry import disc_map
from tools.training.network import Net, ShearNet, trained

OPSET = 13
TOLERANCE = 1e-4
OUTPUTS = {"depth": ["depth_and_contact", "foreign"], "shear": ["displacement"]}
"""Output tensors of each of `network.NETS`, named as in the shipped files,
whose bytes contain these names.
"""


class PerSensor(nn.Module):
    """Computes the part of the first convolution that depends only on a sensor's known maps."""

    def __init__(self, net: Net | ShearNet) -> None:
        super().__init__()
        weight, bias = first_layer(net)
        self.register_buffer("weight", weight[:, net.fold**2 :])
        self.register_buffer("bias", bias)

    def forward(self, known: Tensor) -> Tensor:
        """Run this part of the first layer."""
        return functional.conv2d(known, self.weight, self.bias, padding=1)


class PerFrame(nn.Module):
    """The network as a function of a frame's white and the output of `PerSensor`."""

    def __init__(self, net: Net | ShearNet) -> None:
        super().__init__()
        self.rest = copy.deepcopy(net)
        self.rest.down[0] = self.rest.down[0][3:]
        self.register_buffer("weight", first_layer(net)[0][:, : net.fold**2])

    def forward(self, white: Tensor, sensor: Tensor) -> tuple[Tensor, ...]:
        """Run the network."""
        made = self.rest(functional.relu(functional.conv2d(white, self.weight, padding=1) + sensor))
        return made if isinstance(made, tuple) else (made,)


def first_layer(net: Net | ShearNet) -> tuple[Tensor, Tensor]:
    """Fold the normalisation into the first convolution and return its weight and bias."""
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
    args = parser.parse_args()
    net, state = trained(args.run)
    fold = net.fold
    cells = int(state["arguments"].get("cells", disc_map.CELLS))
    shape = (1, net.down[0][0].in_channels, cells // fold, cells // fold)
    x = torch.rand(shape, generator=torch.Generator().manual_seed(1))
    white, known = x[:, : fold**2], x[:, fold**2 :]
    once, outputs = (
        args.out.with_suffix(".sensor.onnx"),
        OUTPUTS[state["arguments"].get("net", "depth")],
    )
    with torch.no_grad():
        made = net(x)
        sensor = PerSensor(net)(known)
    expected = [y.numpy() for y in (made if isinstance(made, tuple) else (made,))]
    write(PerSensor(net), {"known": known}, ["sensor"], once)
    write(PerFrame(net), {"white": white, "sensor": sensor}, outputs, args.out)
    found = run(
        args.out, {"white": white.numpy(), "sensor": run(once, {"known": known.numpy()})[0]}
    )
    off = max(float(np.abs(f - e).max()) for f, e in zip(found, expected, strict=True))
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()
    rows = [json.loads(line) for line in (args.run / "figures.jsonl").read_text().splitlines()]
    about = {
        "sha256": {
            path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (args.out, once)
        },
        "cells": cells,
        "fold": fold,
        "parameters": sum(p.numel() for p in net.parameters()),
        "commit": commit,
        "training": {
            k: v for k, v in state["arguments"].items() if k not in ("data", "out", "start")
        },
        "steps": state["step"],
        "shards": state["shards"],
        "figures": {k: v for k, v in rows[-1].items() if k != "s_per_step"},
        "run_minus_torch": off,
    }
    args.out.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n")
    print(json.dumps(about, indent=1))
    if off > TOLERANCE:
        raise SystemExit(f"its result differs by {off}, at most {TOLERANCE} was expected")


def write(part: nn.Module, inputs: dict[str, Tensor], outputs: list[str], path: Path) -> None:
    """Write a part of the network."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # this exporter needs only torch
        torch.onnx.export(
            part.eval(),
            tuple(inputs.values()),
            str(path),
            dynamo=False,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=outputs,
        )


def run(path: Path, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Run a part with ONNX Runtime, as the project does."""
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(
        None, inputs
    )


if __name__ == "__main__":
    main()
