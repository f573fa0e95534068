"""The shipped networks of `core.depth.learned`, run by ONNX Runtime on one thread (decision 5)."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacshade_edge.core.depth import DisplacementNetwork, Network, NetworkMaps
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.types import F32, Calibration

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

WEIGHTS = Path(str(resources.files("tacshade_edge.devices.weights")))


def load_network(name: str) -> Network:
    """Read shipped weights (`Profile.network`). One network is for one thread at a time."""
    return read_network(WEIGHTS / f"{name}.onnx")


def read_network(onnx: Path) -> Network:
    """Read an ONNX file and those beside it: JSON and ``.sensor.onnx`` (tools/train/export.py)."""
    session, about = _session(onnx), _about(onnx)

    def run(white: F32, sensor: F32) -> NetworkMaps:
        maps, foreign = session.run(None, {"white": white[None], "sensor": sensor[None]})
        return NetworkMaps(maps[0], foreign[0, 0])

    return Network(int(about["fold"]), _sensing(onnx), run, read_displacement(WEIGHTS / "displacement.onnx"))


def read_displacement(onnx: Path) -> DisplacementNetwork:
    """Read the network of displacement."""
    session, about = _session(onnx), _about(onnx)

    def run(white: F32, sensor: F32) -> F32:
        answer: F32 = session.run(None, {"white": white[None], "sensor": sensor[None]})[0][0]
        return answer

    return DisplacementNetwork(int(about["fold"]), int(about["cells"]), _sensing(onnx), run)


def _about(onnx: Path) -> dict[str, Any]:
    about: dict[str, Any] = json.loads(onnx.with_suffix(".json").read_text())
    return about


def _sensing(onnx: Path) -> Callable[[F32], F32]:
    def sense(known: F32) -> F32:
        answer: F32 = _session(onnx.with_suffix(".sensor.onnx")).run(None, {"known": known[None]})[0][0]
        return answer

    return sense


def _session(onnx: Path) -> InferenceSession:
    import onnxruntime  # on demand: 20 MB that `paper` does without

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3  # it warns of processors that it does not know
    return onnxruntime.InferenceSession(str(onnx), options, providers=["CPUExecutionProvider"])


def load_networks() -> dict[str, Network]:
    """Those of all profiles that a calibration is refitted for."""
    return {name: load_network(profile.network) for name, profile in PROFILES.items() if profile.network}


def make_reconstructor(calibration: Calibration, profile: Profile) -> Reconstructor:
    """A reconstructor, with a network of its own where the profile names one."""
    return Reconstructor(calibration, profile, load_network(profile.network) if profile.network else None)
