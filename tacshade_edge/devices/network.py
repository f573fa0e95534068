"""The shipped network of `core.solvers.accurate`, run by OpenCV's DNN module."""

from __future__ import annotations

import os
from importlib import resources

import cv2
import numpy as np

from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.core.solvers import LEARNED
from tacshade_edge.core.solvers.accurate import Network
from tacshade_edge.types import F32, U8, Calibration


def load_network(onnx: str | os.PathLike[str] | None = None) -> Network:
    """Read the shipped weights, or an ONNX file. One network is for one thread at a time."""
    if onnx is None:
        stored = resources.files("tacshade_edge.core.solvers").joinpath("weights/accurate.onnx").read_bytes()
    else:
        with open(onnx, "rb") as stream:
            stored = stream.read()
    buffer: U8 = np.frombuffer(stored, dtype=np.uint8)
    net = cv2.dnn.readNetFromONNX(buffer)

    def run(maps: F32) -> F32:
        net.setInput(np.ascontiguousarray(maps[None], dtype=np.float32))
        return np.asarray(net.forward()[0], dtype=np.float32)

    return run


def make_reconstructor(calibration: Calibration, profile: Profile) -> Reconstructor:
    """A reconstructor, with a network of its own where the profile wants one."""
    return Reconstructor(calibration, profile, load_network() if profile.solver == LEARNED else None)
