"""The shipped networks in float32, whatever graph a frame goes through."""

from __future__ import annotations

import shutil
from pathlib import Path

from tacshade_edge.core.depth import Network
from tacshade_edge.devices.weights.network import WEIGHTS, read_network


def float_network(name: str, folder: Path) -> Network:
    """Read a copy that has no integer graph beside it."""
    for part in (".onnx", ".sensor.onnx", ".json"):
        shutil.copy(WEIGHTS / f"{name}{part}", folder)
    return read_network(folder / f"{name}.onnx")
