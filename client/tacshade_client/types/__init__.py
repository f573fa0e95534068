"""The daemon's value types that its messages contain."""

from .geometry import (
    F32,
    F64,
    I32,
    I64,
    IDENTITY_POSE,
    U8,
    U16,
    Bool,
    Disc,
    Frame,
    Geometry,
    Pose,
    Skin,
    freeze,
    frozen,
)

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
    "Skin",
    "freeze",
    "frozen",
]
