"""The daemon's value types that its messages contain."""

from .arrays import F32, F64, I32, I64, U8, U16, Bool, freeze, frozen
from .frame import IDENTITY_POSE, Frame, Pose
from .geometry import Disc, Geometry

__all__ = [
    "F32",
    "F64",
    "I32",
    "I64",
    "IDENTITY_POSE",
    "U8",
    "U16",
    "Bool",
    "Disc",
    "Frame",
    "Geometry",
    "Pose",
    "freeze",
    "frozen",
]
