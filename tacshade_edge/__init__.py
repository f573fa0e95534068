"""Metric shape from touch on a small board, for TacShade optical tactile sensors.

The names listed here are the library (docs/reference/library.md); everything else is internal to
the program and may change at any time. A name is imported when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tacshade_edge.errors import ConfigError, DecodeError, DeviceError, TacshadeError
    from tacshade_edge.lab.mjcf.mujoco_sensor import MujocoSensor
    from tacshade_edge.lab.mjcf.mujoco_stream import MujocoStream
    from tacshade_edge.library.frames import open, read, read_hand
    from tacshade_edge.library.result import Result, Results
    from tacshade_edge.library.run_messages import decode, decode_file
    from tacshade_edge.library.sensor import Sensor, load
    from tacshade_edge.library.subscriber import listen
    from tacshade_edge.types import Geometry, Pose, Slip, TouchedObject
    from tacshade_edge.wire.binary import CloudMessage, HeightMessage, ShearMessage, SigmaMessage
    from tacshade_edge.wire.hand_topics import Finger, HandObject, HandObjects, Motion, Unobservable

    __version__: str

__all__ = [
    "CloudMessage",
    "ConfigError",
    "DecodeError",
    "DeviceError",
    "Finger",
    "Geometry",
    "HandObject",
    "HandObjects",
    "HeightMessage",
    "Motion",
    "MujocoSensor",
    "MujocoStream",
    "Pose",
    "Result",
    "Results",
    "Sensor",
    "ShearMessage",
    "SigmaMessage",
    "Slip",
    "TacshadeError",
    "TouchedObject",
    "Unobservable",
    "__version__",
    "decode",
    "decode_file",
    "listen",
    "load",
    "open",
    "read",
    "read_hand",
]

_HOMES = {
    "errors": ("ConfigError", "DecodeError", "DeviceError", "TacshadeError"),
    "lab.mjcf.mujoco_sensor": ("MujocoSensor",),
    "lab.mjcf.mujoco_stream": ("MujocoStream",),
    "library.frames": ("open", "read", "read_hand"),
    "library.subscriber": ("listen",),
    "library.run_messages": ("decode", "decode_file"),
    "library.result": ("Result", "Results"),
    "library.sensor": ("Sensor", "load"),
    "wire.hand_topics": ("Finger", "HandObject", "HandObjects", "Motion", "Unobservable"),
    "wire.binary": ("CloudMessage", "HeightMessage", "ShearMessage", "SigmaMessage"),
    "types": ("Geometry", "Pose", "Slip", "TouchedObject"),
}


if not TYPE_CHECKING:  # otherwise a type checker would accept any name

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from tacshade_edge.version import installed_version

            return installed_version()
        home = next((home for home, names in _HOMES.items() if name in names), None)
        if home is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{__name__}.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
