"""The shipped networks in float32, whatever graph a frame goes through."""

from __future__ import annotations

import shutil
from pathlib import Path

from tacshade_edge.core.depth import Network, ShearNetwork
from tacshade_edge.inference.network import WEIGHTS, read_network, read_shear


def float_network(name: str, folder: Path) -> Network:
    """A network of depth."""
    return read_network(_without_integers(name, folder))


def float_shear(folder: Path) -> ShearNetwork:
    """That of shear."""
    return read_shear(_without_integers("shear", folder))


def _without_integers(name: str, folder: Path) -> Path:
    """A copy that has no integer graph beside it."""
    for part in (".onnx", ".sensor.onnx", ".json"):
        shutil.copy(WEIGHTS / f"{name}{part}", folder)
    return folder / f"{name}.onnx"
