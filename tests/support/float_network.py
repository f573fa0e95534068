"""The shipped networks in float32, whatever graph a frame goes through."""

from __future__ import annotations

import shutil
from pathlib import Path

from tacshade_edge.core.depth import DisplacementNetwork, Network
from tacshade_edge.inference.network import WEIGHTS, read_displacement, read_network


def float_network(name: str, folder: Path) -> Network:
    """A network of depth."""
    return read_network(_without_integers(name, folder))


def float_displacement(folder: Path) -> DisplacementNetwork:
    """That of displacement."""
    return read_displacement(_without_integers("displacement", folder))


def _without_integers(name: str, folder: Path) -> Path:
    """A copy that has no integer graph beside it."""
    for part in (".onnx", ".sensor.onnx", ".json"):
        shutil.copy(WEIGHTS / f"{name}{part}", folder)
    return folder / f"{name}.onnx"
