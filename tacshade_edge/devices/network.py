"""The shipped networks of `core.solvers.learned`, run by OpenCV's DNN module."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core import solvers
from tacshade_edge.core.profiles import LEARNED, PROFILES, Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.core.solvers.learned import Network
from tacshade_edge.types import F32, U8, Calibration

_WEIGHTS = Path(solvers.__file__).parent / "weights"


def load_network(name: str) -> Network:
    """Read the shipped weights of a profile. One network is for one thread at a time."""
    return read_network(_WEIGHTS / f"{name}.onnx")


def read_network(onnx: Path) -> Network:
    """Read an ONNX file and the JSON file beside it (tools/train/export.py)."""
    fold = int(json.loads(onnx.with_name(onnx.name.replace(".onnx", ".json")).read_text())["fold"])
    buffer: U8 = np.frombuffer(onnx.read_bytes(), dtype=np.uint8)
    net = cv2.dnn.readNetFromONNX(buffer)

    def run(maps: F32) -> F32:
        net.setInput(np.ascontiguousarray(maps[None], dtype=np.float32))
        return np.asarray(net.forward()[0], dtype=np.float32)

    return Network(fold, run)


def load_networks() -> dict[str, Network]:
    """All that a calibration is to be refitted for."""
    return {name: load_network(name) for name, profile in PROFILES.items() if profile.solver == LEARNED}


def make_reconstructor(calibration: Calibration, profile: Profile) -> Reconstructor:
    """A reconstructor, with a network of its own where the profile wants one."""
    return Reconstructor(calibration, profile, load_network(profile.name) if profile.solver == LEARNED else None)
