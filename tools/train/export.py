#!/usr/bin/env python3
"""Write a checkpoint as ONNX, prove that ONNX Runtime runs it alike, and say where it came from.

::

    .venv-train/bin/python tools/train/export.py --run RUN --out accurate.onnx

Beside the ONNX file goes a JSON file of the same name: command, seed, commit, data, figures, SHA-256.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import warnings
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from network import Net
from torch.nn import functional

from tacshade_edge.core import discmap
from tacshade_edge.core.solvers.learned import inputs

OPSET = 13
TOLERANCE = 1e-4


def main() -> None:
    """Export and check."""
    parser = argparse.ArgumentParser(description="Export the learned inverse.")
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    state = torch.load(args.run / "checkpoint.pt", weights_only=True)
    widths = tuple(int(w) for w in state["arguments"]["widths"].strip("()[]").split(","))
    mean = {k.removeprefix("module."): v for k, v in state["mean"].items() if k.startswith("module.")}
    fold = int(state["arguments"]["fold"])
    net = Net(fold, widths)
    net.load_state_dict(mean)
    net.eval()
    first, cells = net.down[0][0], int(state["arguments"].get("cells", discmap.CELLS))
    first.weight = torch.nn.Parameter(functional.pad(first.weight, (0, 0, 0, 0, 0, inputs(fold) - first.in_channels)))
    first.in_channels = inputs(fold)
    x = torch.rand(1, inputs(fold), cells // fold, cells // fold, generator=torch.Generator().manual_seed(1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the exporter that needs nothing beside torch
        torch.onnx.export(net, (x,), str(args.out), dynamo=False, opset_version=OPSET, input_names=["maps"],
                          output_names=["depth_and_contact"])  # fmt: skip
    run = onnxruntime.InferenceSession(str(args.out), providers=["CPUExecutionProvider"]).run
    with torch.no_grad():
        expected = net(x).numpy()
    off = float(np.abs(run(None, {"maps": x.numpy()})[0] - expected).max())
    sha256 = hashlib.sha256(args.out.read_bytes()).hexdigest()
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    rows = [json.loads(line) for line in (args.run / "figures.jsonl").read_text().splitlines()]
    about = {
        "sha256": sha256,
        "bytes": args.out.stat().st_size,
        "cells": cells,
        "fold": fold,
        "parameters": sum(p.numel() for p in net.parameters()),
        "commit": commit,
        "training": {k: v for k, v in state["arguments"].items() if k not in ("data", "out", "start")},
        "steps": state["step"],
        "shards": state["shards"],
        "figures": {k: v for k, v in rows[-1].items() if k != "s_per_step"},
        "run_minus_torch": off,
    }
    args.out.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n")
    print(json.dumps(about, indent=1))
    if off > TOLERANCE:
        raise SystemExit(f"its result differs by {off}, at most {TOLERANCE} was expected")


if __name__ == "__main__":
    main()
